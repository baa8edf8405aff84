// Decode and encode for the tests: reads JSON lines and answers each with one.
// Values are written without loss: lists as ["list", …], maps as ["map", [key, value], …],
// bytes as ["bytes", hexadecimal], and numbers that JSON has not as ["number", text]. To encode,
// there are also ["undefined"], ["function"], and ["new", class] for an object of a global class.
import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";

const address = pathToFileURL(process.argv[2]).href;
const { decode, encode, DecodeError } = await import(address);

function shown(value) {
  if (Array.isArray(value)) return ["list", ...value.map(shown)];
  if (value instanceof Uint8Array) return ["bytes", Buffer.from(value).toString("hex")];
  if (value !== null && typeof value === "object") {
    if (Object.getPrototypeOf(value) !== Object.prototype) return ["no plain object"];
    return ["map", ...Object.entries(value).map(([key, field]) => [key, shown(field)])];
  }
  const inJson = typeof value !== "number" || (Number.isFinite(value) && !Object.is(value, -0));
  return inJson ? value : ["number", Object.is(value, -0) ? "-0" : String(value)];
}

function meant(value) {
  if (!Array.isArray(value)) return value;
  const [kind, ...rest] = value;
  if (kind === "list") return rest.map(meant);
  if (kind === "map") return Object.fromEntries(rest.map(([key, field]) => [key, meant(field)]));
  if (kind === "bytes") return new Uint8Array(Buffer.from(rest[0], "hex"));
  if (kind === "number") return Number(rest[0]);
  return kind === "new" ? new globalThis[rest[0]](4) : { undefined: undefined, function: meant }[kind];
}

async function answer({ decode: hex, encode: value, fresh }) {
  try {
    if (fresh !== undefined) { // a module of its own, of which the buffer has its first size
      const own = await import(`${address}?${fresh}`);
      return { bytes: Buffer.from(own.encode(meant(value))).toString("hex") };
    }
    if (hex === undefined) {
      const bytes = encode(meant(value));
      encode("what comes next"); // and must not change what was encoded
      return { bytes: Buffer.from(bytes).toString("hex") };
    }
    const frame = Buffer.from(`ffff${hex}ffff`, "hex"); // a view that begins within its buffer
    const decoded = decode(new Uint8Array(frame.buffer, frame.byteOffset + 2, hex.length / 2));
    frame.fill(0); // as whoever gave the bytes may use them again
    return { value: shown(decoded) };
  } catch (error) {
    return { error: error instanceof DecodeError ? "DecodeError" : error.name, message: error.message };
  }
}

for await (const line of createInterface({ input: process.stdin })) {
  const text = JSON.stringify(await answer(JSON.parse(line)));
  if (Object.keys(Object.prototype).length > 0) throw new Error(`polluted by ${line}`);
  process.stdout.write(`${text}\n`);
}
