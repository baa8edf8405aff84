/** The connection to a server: requests and their answers, events, and what comes after a loss. */

import { ClockOffset, now_us } from "./clock.js";
import { Display } from "./display.js";
import type { TelemetryListener } from "./display.js";
import { ClientError, DisconnectedError, RequestError } from "./errors.js";
import { DisplayMemory, PendingEstops } from "./memory.js";
import type { WantedTelemetry } from "./memory.js";
import { API_VERSION, MSGPACK_PROTOCOL, PATH } from "./messages.js";
import type {
  Answer,
  AppendedReply,
  Command,
  Contact,
  Done,
  DrawTexture,
  EffectInfo,
  Effects,
  EventMessage,
  Failure,
  OnsetMessage,
  Pong,
  StatsReply,
  TactileFrames,
  TextureInfo,
  TexturePicture,
  Textures,
  Welcome,
} from "./messages.js";
import { DecodeError, decode, encode } from "./msgpack.js";
import { StreamPacing } from "./pacing.js";
import { faultOf, isKnown, isTyped } from "./validation.js";
import type { Typed } from "./validation.js";

/** Interval between pings, each of which also measures the clocks [ms]. */
const PING_INTERVAL_MS = 1000;
/** Time without an answer to what is answered at once, after which a connection is given up [µs]. */
const SILENCE_US = 3e6;
/** Requests that the server answers at once, whatever else it does. */
const PROMPT: readonly string[] = ["ping", "estop"];
/** Time in which a new connection must be open, and the server must have welcomed us [µs]. */
const WELCOME_WITHIN_US = 10e6;
/** Time after which a question for the state is given up [µs]: it may be asked again. */
const STATS_WITHIN_US = 10e6;
/** Limits of the pause before a reconnection [ms]; it doubles each time, less a random half. */
const FIRST_PAUSE_MS = 100;
const LONGEST_PAUSE_MS = 5000;
/** Maximum number of requests that wait for an answer, without those that make a display quieter. */
const MOST_WAITING = 256;
/** Amount of unsent data above which contacts and frames are left out, as they would be old [bytes]. */
const MOST_UNSENT = 16 * 1024;
/** Close codes after which the same hello would be refused again. */
const FINAL_CODES: ReadonlySet<number> = new Set([1002, 4400, 4401, 4406]);

/** The part of a WebSocket that the client uses, which those of browsers and of `ws` share. */
export interface Socket {
  binaryType: string;
  readonly bufferedAmount: number;
  onopen: ((event: any) => void) | null;
  onmessage: ((event: any) => void) | null;
  onclose: ((event: any) => void) | null;
  onerror: ((event: any) => void) | null;
  send(data: Uint8Array): void;
  close(): void;
}

/** What `connect` takes. */
export interface ConnectOptions {
  /** Address of the server; in a page by default that of the server that the page came from. */
  url?: string;
  /** Name of the program, for logs and for the reason of an e-stop. */
  client?: string;
  /** Token of the server's configuration, if it requires one. */
  token?: string;
  /** Class of the WebSocket; by default the global one, which node has since version 22. */
  webSocket?: new (url: string, protocol: string) => Socket;
}

/**
 * State of a connection. "refused": the server refuses this client for good, so that it is not
 * tried again; "closed": by `close`.
 */
export type ConnectionState = "connecting" | "connected" | "refused" | "closed";

/** Reply to each type of request; all others are answered by `Done`. */
interface Replies {
  hello: Welcome;
  list_textures: Textures;
  draw_texture: TexturePicture;
  list_effects: Effects;
  append: AppendedReply;
  get_stats: StatsReply;
  ping: Pong;
}
/** Types of these replies. */
const REPLIES: { readonly [K in keyof Replies]: Replies[K]["type"] } = {
  hello: "welcome",
  list_textures: "textures",
  draw_texture: "texture_picture",
  list_effects: "effects",
  append: "appended",
  get_stats: "stats",
  ping: "pong",
};
/** A message that the server answers. */
export type RequestMessage = Exclude<Command, Contact | TactileFrames>;
/** Reply to a request. */
export type ReplyTo<C extends RequestMessage> = C["type"] extends keyof Replies
  ? Replies[C["type"]]
  : Done;

/** A request that waits for its answer. */
interface Waiting {
  command: RequestMessage;
  sent_us: number;
  resolve: (answer: any) => void;
  reject: (error: ClientError) => void;
}

/** Listeners by kind, with what each of them gets. */
interface Listened {
  state: Connection;
  event: EventMessage;
  onset: OnsetMessage;
  failure: Failure;
}

/**
 * Connect to a server, and again whenever the connection is lost, until `close` is called.
 *
 * @returns The connection at once; `ready()` waits for the server.
 */
export function connect(options: ConnectOptions = {}): Connection {
  return new Connection(options);
}

/** Connection to a server over any number of WebSockets. */
export class Connection {
  /** What the server said about itself when it was last connected to. */
  welcome: Welcome | undefined;
  /** State of the connection. */
  state: ConnectionState = "connecting";
  /** Why there is no connection, in a sentence; empty while there is one. */
  reason = "not connected yet";
  /** Number of messages of the server that are not as the API has them. */
  ignoredMessages = 0;

  private readonly url: string;
  private socket: Socket | undefined;
  private opened_us = 0;
  private refusal = "";
  private waiting = new Map<number, Waiting>();
  private lastId = 0;
  private pause_ms = FIRST_PAUSE_MS;
  private retry: ReturnType<typeof setTimeout> | undefined;
  private readonly pinging: ReturnType<typeof setInterval>;
  private clock = new ClockOffset();
  private pacing = new StreamPacing(0);
  private readonly estops = new PendingEstops();
  private readonly memories = new Map<string, DisplayMemory>();
  private readonly known = new Map<string, Display>();
  private readonly listeners: { [K in keyof Listened]: Set<(value: Listened[K]) => void> } = {
    state: new Set(),
    event: new Set(),
    onset: new Set(),
    failure: new Set(),
  };

  constructor(private readonly options: ConnectOptions = {}) {
    this.url = options.url ?? ownServer();
    this.pinging = setInterval(() => this.checkAlive(), PING_INTERVAL_MS);
    this.open();
  }

  /** Duration of the quickest of the last exchanges with the server [ms], if there was one. */
  get roundTrip_ms(): number | undefined {
    const roundTrip_us = this.clock.roundTrip_us;
    return roundTrip_us === undefined ? undefined : roundTrip_us / 1000;
  }

  /** Return the present time of the server's monotonic clock [µs], if it is known. */
  serverTime_us(): number | undefined {
    const offset_us = this.clock.offset_us;
    return offset_us === undefined ? undefined : now_us() + offset_us;
  }

  /** Displays of the server. */
  get displays(): readonly Display[] {
    return (this.welcome?.displays ?? []).map(({ name }) => this.displayNamed(name));
  }

  /**
   * Return a display of the server.
   *
   * @param name Name of the display, by default that of the first one. Throws if there is none.
   */
  display(name?: string): Display {
    const displays = this.displays;
    const chosen = displays.find((display) => name === undefined || display.name === name);
    if (chosen !== undefined) return chosen;
    const names = displays.map((display) => display.name).join(", ") || "none yet";
    throw new ClientError(`no display ${JSON.stringify(name ?? "")}; there are: ${names}`);
  }

  /** Wait until the server has admitted this client; rejected if it refuses it. */
  ready(): Promise<Welcome> {
    return new Promise((resolve, reject) => {
      const settle = (): boolean => {
        if (this.state === "connected" && this.welcome) resolve(this.welcome);
        else if (this.state !== "connecting") reject(new DisconnectedError(this.reason));
        return this.state !== "connecting";
      };
      if (settle()) return;
      const remove = this.on("state", () => {
        if (settle()) remove();
      });
    });
  }

  /** Return all textures of the server. */
  async textures(): Promise<TextureInfo[]> {
    return (await this.request({ type: "list_textures" })).textures;
  }

  /**
   * Return a picture of the surface of a texture, which may take a second.
   *
   * @param section Texture, and what to draw of it.
   */
  async drawTexture(section: Omit<DrawTexture, "type" | "id">): Promise<TexturePicture> {
    const picture = await this.request({ type: "draw_texture", ...section });
    const [wanted, sent] = [section.columns * section.rows, picture.pixels.length];
    if (sent !== wanted) throw new ClientError(`the picture has ${sent} pixels, not ${wanted}`);
    return picture;
  }

  /** Return all effects of the server. */
  async effects(): Promise<EffectInfo[]> {
    return (await this.request({ type: "list_effects" })).effects;
  }

  /**
   * Set all displays to 0 V at once, until each is cleared; see `Display.estop`.
   *
   * @returns Number of the e-stop by name of the display.
   */
  async estop(): Promise<Record<string, number>> {
    return (await this.request({ type: "estop" })).estops ?? {};
  }

  /**
   * Call a function with each change of the state, each event, each report on what was to begin at
   * a time, or each failure that answers no request, such as that of a contact that cannot be used.
   *
   * @returns Function that ends it.
   */
  on<K extends keyof Listened>(kind: K, listener: (value: Listened[K]) => void): () => void {
    this.listeners[kind].add(listener);
    return () => this.listeners[kind].delete(listener);
  }

  /** End the connection; nothing is answered any more. */
  close(): void {
    clearInterval(this.pinging);
    clearTimeout(this.retry);
    this.lost("closed by this program", "closed");
  }

  /** Send a request and wait for its answer; `Display` has a method for each. */
  request<C extends RequestMessage>(command: C): Promise<ReplyTo<C>> {
    const quieter = ["estop", "disarm", "stop"].includes(command.type);
    if (this.state !== "connected") {
      if (command.type === "estop") this.estops.add(command, 0);
      return Promise.reject(this.disconnected(command));
    }
    if (this.waiting.size >= MOST_WAITING && !quieter) {
      const text = `${MOST_WAITING} requests are already waiting for an answer`;
      return Promise.reject(new ClientError(text));
    }
    return this.send(command);
  }

  /** Send a contact, or count it if that is not possible now. */
  sendContact(contact: Contact): void {
    if (!this.stream(contact, contact.normal_force_n === 0)) {
      this.memory(contact.display).droppedContacts += 1;
    }
  }

  /** Send tactile frames, or count the message if that is not possible now. */
  sendFrames(frames: TactileFrames): void {
    if (!this.stream(frames, false)) this.memory(frames.display).droppedFrames += 1;
  }

  /** Send a message of a stream if that is possible now, and return whether it was. */
  private stream(message: Contact | TactileFrames, urgent: boolean): boolean {
    if (this.state !== "connected" || this.socket === undefined) return false;
    const late = this.socket.bufferedAmount > MOST_UNSENT;
    if (!urgent && (late || !this.pacing.take(now_us()))) return false;
    this.socket.send(encode(message));
    return true;
  }

  /** Return what outlasts a connection of one display. */
  memory(display: string): DisplayMemory {
    let memory = this.memories.get(display);
    if (memory === undefined) {
      memory = new DisplayMemory();
      this.memories.set(display, memory);
    }
    return memory;
  }

  /** Call a function with telemetry of a display; return the function that ends it. */
  subscribe(display: string, wanted: WantedTelemetry, listener: TelemetryListener): () => void {
    const memory = this.memory(display);
    const update = () => {
      if (this.state === "connected") this.sendUnasked(memory.subscription(display));
    };
    memory.listeners.delete(listener); // what is wanted last comes last
    memory.listeners.set(listener, wanted);
    update();
    return () => {
      memory.listeners.delete(listener);
      update();
    };
  }

  private displayNamed(name: string): Display {
    let display = this.known.get(name);
    if (display === undefined) {
      display = new Display(this, name);
      this.known.set(name, display);
    }
    return display;
  }

  // Opening and losing a WebSocket

  private open(): void {
    const Socket = this.options.webSocket ?? globalThis.WebSocket;
    if (Socket === undefined) {
      this.lost("there is no WebSocket here: pass `webSocket`, such as that of `ws`", "refused");
      return;
    }
    this.refusal = "";
    let socket: Socket;
    try {
      socket = new Socket(this.url, MSGPACK_PROTOCOL);
    } catch (error) {
      this.lost(`cannot connect to ${this.url}: ${(error as Error).message}`, "refused");
      return;
    }
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.opened_us = now_us();
    const current = () => this.socket === socket;
    socket.onopen = () => current() && this.sayHello();
    socket.onmessage = ({ data }) => current() && this.receive(data);
    socket.onclose = ({ code, reason }) => current() && this.closed(code, String(reason));
    socket.onerror = () => undefined; // `onclose` follows
  }

  private sayHello(): void {
    this.waiting.clear();
    const { client = "tactile-client", token = "" } = this.options;
    this.send({ type: "hello", client, version: API_VERSION, token }).catch((error) => {
      if (error instanceof RequestError) this.refusal = error.message; // it is closed next
    });
  }

  private closed(code: number, reason: string): void {
    const text = this.refusal || reason || `the server at ${this.url} does not answer`;
    this.lost(text, FINAL_CODES.has(code) ? "refused" : "connecting");
  }

  private lost(reason: string, state: Exclude<ConnectionState, "connected">): void {
    if (this.state === "closed" || this.state === "refused") return;
    const socket = this.socket;
    this.socket = undefined;
    this.state = state;
    this.reason = reason;
    this.estops.disconnect();
    const waiting = [...this.waiting.values()];
    this.waiting.clear();
    for (const { command, reject } of waiting) reject(this.disconnected(command));
    socket?.close();
    if (state === "connecting") this.openLater();
    else clearInterval(this.pinging);
    this.notify("state", this);
  }

  private openLater(): void {
    const pause_ms = this.pause_ms * (1 - Math.random() / 2);
    this.pause_ms = Math.min(2 * this.pause_ms, LONGEST_PAUSE_MS);
    this.retry = setTimeout(() => this.open(), pause_ms);
  }

  private disconnected(command: RequestMessage): DisconnectedError {
    const kept = command.type === "estop" && this.state === "connecting";
    const text = kept ? "; the e-stop is kept and will be sent first when the server is back" : "";
    return new DisconnectedError(`not connected: ${this.reason}${text}`);
  }

  private checkAlive(): void {
    const now = now_us();
    const isLate = ({ command, sent_us }: Waiting) =>
      PROMPT.includes(command.type) && now - sent_us > SILENCE_US;
    if (this.state === "connecting") {
      const isOpening = this.socket !== undefined;
      if (!isOpening || now - this.opened_us < WELCOME_WITHIN_US) return;
      this.lost(this.refusal || "the server does not answer", "connecting");
    } else if (this.state === "connected") {
      this.giveUpStats(now - STATS_WITHIN_US);
      if ([...this.waiting.values()].some(isLate)) {
        this.lost("the server does not answer", "connecting");
      } else {
        this.sendUnasked({ type: "ping", time_us: now });
      }
    }
  }

  /** Reject questions for the state that are older than a time: their answers may be lost. */
  private giveUpStats(oldest_us: number): void {
    for (const [id, { command, sent_us, reject }] of [...this.waiting]) {
      if (command.type !== "get_stats" || sent_us > oldest_us) continue;
      this.waiting.delete(id);
      reject(new ClientError("the server does not answer"));
    }
  }

  // Messages

  private send<C extends RequestMessage>(command: C): Promise<ReplyTo<C>> {
    const id = (this.lastId += 1);
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { command, sent_us: now_us(), resolve, reject });
      if (command.type === "estop") this.estops.add(command, id);
      this.socket?.send(encode({ ...command, id }));
    });
  }

  /** Send a request of the client's own; what is wrong with it is a failure without a request. */
  private sendUnasked(command: RequestMessage): void {
    this.send(command).catch((error) => {
      if (error instanceof RequestError) this.notify("failure", error.failure);
    });
  }

  private receive(data: unknown): void {
    const message = decoded(data);
    const fault = message && faultOf(message);
    if (message === undefined) this.giveUp("the server sends what is no message");
    else if (fault) this.takeFaulty(message, fault);
    else this.take(message as unknown as Answer);
  }

  private take(answer: Answer): void {
    if (answer.type === "telemetry") {
      for (const listener of [...(this.memories.get(answer.display)?.listeners.keys() ?? [])]) {
        call(listener, answer);
      }
    } else if (answer.type === "event") {
      if (answer.kind === "estopped") this.setEstop(answer.display, answer.estop ?? 0);
      if (answer.kind === "cleared") this.setEstop(answer.display, 0);
      this.notify("event", answer);
    } else if (answer.type === "onset") {
      this.notify("onset", answer);
    } else if (answer.id === undefined || answer.id === null) {
      if (answer.type === "failure") this.notify("failure", answer);
      else this.giveUp(`the server sends ${answer.type} without an id`);
    } else {
      this.answered({ ...answer, id: answer.id });
    }
  }

  /**
   * Take a message that is not as the API has it. If it is an answer, its request fails. All others
   * are ignored, unless a request could wait for them for ever.
   */
  private takeFaulty({ type, id }: Typed, fault: string): void {
    const text = `${type} of the server cannot be read: ${fault}`;
    const waiting = this.waiting.get(id as number);
    const { type: asked = "" } = waiting?.command ?? {};
    if (asked === "hello" || asked === "estop") { // an e-stop is sent again
      this.giveUp(text);
    } else if (waiting !== undefined) {
      this.ignoredMessages += 1;
      const message = text;
      this.answered({ type: "failure", id: id as number, code: "internal", message });
    } else if (isKnown(type) && !["event", "onset", "telemetry"].includes(type) && !Number.isInteger(id)) {
      this.giveUp(text);
    } else {
      this.ignoredMessages += 1;
    }
  }

  /** Connect anew, as an answer may be lost for which a request would wait. */
  private giveUp(reason: string): void {
    this.ignoredMessages += 1;
    this.lost(reason, "connecting");
  }

  private setEstop(display: string, estop: number): void {
    const memory = this.memories.get(display); // those of displays that the welcome had
    if (memory) memory.estop = estop;
  }

  private answered(answer: Exclude<Answer, { type: "telemetry" | "event" | "onset" }> & { id: number }) {
    const { id } = answer;
    const waiting = this.waiting.get(id);
    if (waiting === undefined) return;
    const { type } = waiting.command;
    const expected = type in REPLIES ? REPLIES[type as keyof Replies] : "done";
    if (answer.type !== "failure" && answer.type !== expected) {
      this.takeFaulty({ type: answer.type, id }, `it is no answer to ${type}`);
      return;
    }
    this.waiting.delete(id);
    this.estops.resolve(answer);
    if (answer.type === "failure") {
      waiting.reject(new RequestError(answer));
      return;
    }
    this.learn(answer, waiting);
    waiting.resolve(answer);
  }

  /** Take from an answer what the client itself needs. */
  private learn(answer: Answer, { command, sent_us }: Waiting): void {
    if (answer.type === "welcome") {
      this.welcomedBy(answer, sent_us);
    } else if (answer.type === "pong") {
      this.clock.add(sent_us, answer.server_time_us, now_us());
    } else if (answer.type === "stats") {
      this.setEstop(answer.display, answer.estop ?? 0);
    } else if (answer.type === "done") {
      for (const [display, estop] of Object.entries(answer.estops ?? {})) {
        this.setEstop(display, estop);
      }
      if ("display" in command && command.display) this.memory(command.display).confirm(command);
    }
  }

  /** Send unconfirmed e-stops first, then what restores the state; nothing arms. */
  private welcomedBy(welcome: Welcome, sent_us: number): void {
    this.welcome = welcome;
    this.clock = new ClockOffset();
    this.clock.add(sent_us, welcome.time_us, now_us());
    this.pacing = new StreamPacing(welcome.messages_per_second ?? 0);
    this.pause_ms = FIRST_PAUSE_MS;
    for (const { name, estop } of welcome.displays) this.memory(name).estop = estop ?? 0;
    for (const estop of this.estops.unsent()) this.sendUnasked(estop);
    for (const [display, memory] of this.memories) {
      for (const command of memory.restoring(display)) this.sendUnasked(command as RequestMessage);
    }
    this.state = "connected";
    this.reason = "";
    this.notify("state", this);
  }

  private notify<K extends keyof Listened>(kind: K, value: Listened[K]): void {
    for (const listener of [...this.listeners[kind]]) call(listener, value);
  }
}

/** Return a message; undefined for what is none. */
function decoded(data: unknown): Typed | undefined {
  if (typeof data === "string") return undefined;
  try {
    const value = decode(new Uint8Array(data as ArrayBuffer));
    return isTyped(value) ? value : undefined;
  } catch (error) {
    if (!(error instanceof DecodeError)) throw error;
    return undefined;
  }
}

/** Call a listener; what it throws is reported, and harms no other one. */
function call<T>(listener: (value: T) => void, value: T): void {
  try {
    listener(value);
  } catch (error) {
    queueMicrotask(() => {
      throw error;
    });
  }
}

/** Return the address of the server that this page came from. */
function ownServer(): string {
  if (typeof location === "undefined") throw new ClientError("url: is needed outside of a page");
  return `${location.protocol === "https:" ? "wss:" : "ws:"}//${location.host}${PATH}`;
}
