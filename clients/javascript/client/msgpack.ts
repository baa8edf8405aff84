/**
 * MessagePack as far as the API needs it: all of its types but extensions, maps with texts as keys.
 * The format is defined in https://github.com/msgpack/msgpack/blob/master/spec.md.
 */

/** Error about bytes that are not one value of MessagePack. */
export class DecodeError extends Error {
  override readonly name = "DecodeError";
}

/** Maximum depth of arrays and maps within each other; messages of the API have at most 4. */
export const DEEPEST = 64;

/** Length up to which the first byte holds that of a text, and single characters are faster. */
const SHORT = 31;
/** Number of values of 32 bits. */
const WORD = 2 ** 32;

const textEncoder = new TextEncoder();
const textDecoder = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });

// Encoding

/** Buffer of all calls, which grows as needed. */
let buffer = new Uint8Array(4096);
let view = new DataView(buffer.buffer);
/** Position in the buffer at which the next byte is written. */
let end = 0;

/**
 * Encode a value.
 *
 * Integers up to 2^53 are encoded as integers, all other numbers as float64. Fields of objects that
 * are undefined are left out; elsewhere undefined is encoded as nil. Throws a TypeError for what
 * MessagePack does not have, such as functions, and for what is nested deeper than `DEEPEST`.
 */
export function encode(value: unknown): Uint8Array {
  end = 0;
  writeValue(value, 0);
  return buffer.slice(0, end);
}

/** Make room for a number of bytes and return the position at which they begin. */
function reserve(size: number): number {
  const start = end;
  end += size;
  if (end > buffer.length) {
    const larger = new Uint8Array(2 * end);
    larger.set(buffer);
    buffer = larger;
    view = new DataView(buffer.buffer);
  }
  return start;
}

function writeValue(value: unknown, depth: number): void {
  switch (typeof value) {
    case "string":
      return writeText(value);
    case "number":
      return writeNumber(value);
    case "boolean":
      return writeByte(value ? 0xc3 : 0xc2);
    case "undefined":
      return writeByte(0xc0);
    case "object":
      return value === null ? writeByte(0xc0) : writeObject(value, depth + 1);
    default:
      throw new TypeError(`a ${typeof value} cannot be encoded as MessagePack`);
  }
}

function writeObject(value: object, depth: number): void {
  if (depth > DEEPEST) {
    throw new TypeError(`arrays and objects are nested deeper than ${DEEPEST}`);
  }
  if (Array.isArray(value)) {
    writeHead(value.length, 15, 0x90, 0, 0xdc);
    for (const item of value) writeValue(item, depth);
  } else if (value instanceof Uint8Array) {
    writeHead(value.length, -1, 0, 0xc4, 0xc5);
    writeBytes(value);
  } else if (ArrayBuffer.isView(value) || value instanceof ArrayBuffer) {
    throw new TypeError("of binary data, only a Uint8Array can be encoded as MessagePack");
  } else {
    const fields = Object.entries(value).filter(([, field]) => field !== undefined);
    writeHead(fields.length, 15, 0x80, 0, 0xde);
    for (const [key, field] of fields) {
      writeText(key);
      writeValue(field, depth);
    }
  }
}

// What is reserved may be in a new buffer, so that `reserve` is called in a line of its own.

function writeByte(byte: number): void {
  const start = reserve(1);
  buffer[start] = byte;
}

function writeBytes(bytes: Uint8Array): void {
  const start = reserve(bytes.length);
  buffer.set(bytes, start);
}

/**
 * Write the head of a text, array or map: its length in the first byte if it is at most `fixed`,
 * else after `code8` if there is one, after `code16`, or after the code behind that.
 */
function writeHead(size: number, fixed: number, base: number, code8: number, code16: number): void {
  if (size <= fixed) {
    writeByte(base | size);
  } else if (code8 !== 0 && size < 0x100) {
    writeByte(code8);
    writeByte(size);
  } else if (size < 0x10000) {
    writeByte(code16);
    const start = reserve(2);
    view.setUint16(start, size);
  } else {
    writeByte(code16 + 1);
    const start = reserve(4);
    view.setUint32(start, size);
  }
}

function writeText(text: string): void {
  if (text.length <= SHORT && writeAscii(text)) return;
  const bytes = textEncoder.encode(text);
  writeHead(bytes.length, SHORT, 0xa0, 0xd9, 0xda);
  writeBytes(bytes);
}

/** Write a short text of ASCII characters, or return false and write nothing. */
function writeAscii(text: string): boolean {
  const start = reserve(1 + text.length);
  buffer[start] = 0xa0 | text.length;
  for (let i = 0; i < text.length; i++) {
    const code = text.charCodeAt(i);
    if (code > 0x7f) {
      end = start;
      return false;
    }
    buffer[start + 1 + i] = code;
  }
  return true;
}

function writeNumber(value: number): void {
  if (!Number.isInteger(value) || Math.abs(value) > 2 ** 53) {
    writeByte(0xcb);
    const start = reserve(8);
    view.setFloat64(start, value);
  } else if (value >= -32 && value < 128) {
    writeByte(value & 0xff);
  } else if (value >= 0 ? value < 0x100 : value >= -0x80) {
    writeByte(value >= 0 ? 0xcc : 0xd0);
    writeByte(value & 0xff);
  } else if (value >= 0 ? value < 0x10000 : value >= -0x8000) {
    writeByte(value >= 0 ? 0xcd : 0xd1);
    const start = reserve(2);
    view.setUint16(start, value);
  } else if (value >= 0 ? value < WORD : value >= -WORD / 2) {
    writeByte(value >= 0 ? 0xce : 0xd2);
    const start = reserve(4);
    view.setUint32(start, value);
  } else {
    writeByte(value >= 0 ? 0xcf : 0xd3);
    const start = reserve(8);
    view.setInt32(start, Math.floor(value / WORD));
    view.setUint32(start + 4, value);
  }
}

// Decoding

/**
 * Decode one value.
 *
 * Integers beyond 2^53 become the nearest number. Throws a `DecodeError` for everything that is not
 * exactly one value of the types named above.
 */
export function decode(bytes: Uint8Array): unknown {
  const reader = new Reader(bytes);
  const value = reader.value(0);
  if (reader.left > 0) throw new DecodeError(`${reader.left} bytes follow the value`);
  return value;
}

/** Reader of values from bytes that may be anything. */
class Reader {
  private at = 0;
  private readonly view: DataView;

  constructor(private readonly bytes: Uint8Array) {
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  /** Number of bytes that have not been read. */
  get left(): number {
    return this.bytes.length - this.at;
  }

  value(depth: number): unknown {
    const code = this.uint(1);
    if (code < 0x80) return code;
    if (code < 0x90) return this.map(code & 0x0f, depth + 1);
    if (code < 0xa0) return this.array(code & 0x0f, depth + 1);
    if (code < 0xc0) return this.text(code & 0x1f);
    if (code >= 0xe0) return code - 0x100;
    switch (code) {
      case 0xc0: return null;
      case 0xc2: return false;
      case 0xc3: return true;
      case 0xc4: case 0xc5: case 0xc6: return this.binary(this.uint(1 << (code - 0xc4)));
      case 0xca: return this.view.getFloat32(this.take(4));
      case 0xcb: return this.view.getFloat64(this.take(8));
      case 0xcc: case 0xcd: case 0xce: return this.uint(1 << (code - 0xcc));
      case 0xcf: return this.uint(4) * WORD + this.uint(4);
      case 0xd0: return this.view.getInt8(this.take(1));
      case 0xd1: return this.view.getInt16(this.take(2));
      case 0xd2: return this.view.getInt32(this.take(4));
      case 0xd3: return this.view.getInt32(this.take(4)) * WORD + this.uint(4);
      case 0xd9: case 0xda: case 0xdb: return this.text(this.uint(1 << (code - 0xd9)));
      case 0xdc: case 0xdd: return this.array(this.uint(2 << (code - 0xdc)), depth + 1);
      case 0xde: case 0xdf: return this.map(this.uint(2 << (code - 0xde)), depth + 1);
      default: throw new DecodeError(`0x${code.toString(16)} begins no value of the API`);
    }
  }

  /** Pass over a number of bytes and return the position at which they begin. */
  private take(size: number): number {
    if (size > this.left) throw new DecodeError(`${size} bytes are due, and ${this.left} are left`);
    const start = this.at;
    this.at += size;
    return start;
  }

  private uint(size: number): number {
    const start = this.take(size);
    if (size === 1) return this.view.getUint8(start);
    return size === 2 ? this.view.getUint16(start) : this.view.getUint32(start);
  }

  private binary(size: number): Uint8Array {
    const start = this.take(size);
    return this.bytes.slice(start, start + size);
  }

  private text(size: number): string {
    const start = this.take(size);
    let text = "";
    if (size <= SHORT) {
      let i = 0;
      for (let byte; i < size && (byte = this.bytes[start + i] as number) < 0x80; i++) {
        text += String.fromCharCode(byte);
      }
      if (i === size) return text;
    }
    try {
      return textDecoder.decode(this.bytes.subarray(start, start + size));
    } catch {
      throw new DecodeError("a text is not UTF-8");
    }
  }

  /** Check that a container is not too deep and that its values, of a byte at least, can follow. */
  private enter(values: number, depth: number): void {
    if (depth > DEEPEST) throw new DecodeError(`values are nested deeper than ${DEEPEST}`);
    if (values > this.left) {
      throw new DecodeError(`${values} values are due, and ${this.left} bytes are left`);
    }
  }

  private array(size: number, depth: number): unknown[] {
    this.enter(size, depth);
    const array: unknown[] = [];
    for (let i = 0; i < size; i++) array.push(this.value(depth));
    return array;
  }

  private map(size: number, depth: number): Record<string, unknown> {
    this.enter(2 * size, depth);
    const map: Record<string, unknown> = {};
    for (let i = 0; i < size; i++) {
      const key = this.value(depth);
      if (typeof key !== "string") throw new DecodeError("a key of a map is not a text");
      const value = this.value(depth);
      if (key === "__proto__") {
        // An assignment would replace the prototype of the object.
        const own = { value, configurable: true, enumerable: true, writable: true };
        Object.defineProperty(map, key, own);
      } else {
        map[key] = value;
      }
    }
    return map;
  }
}
