/** The connection to a server: requests and their answers, events, and what comes after a loss. */
import { ClockOffset, now_us } from "./clock.js";
import { Display } from "./display.js";
import { ClientError, DisconnectedError, RequestError } from "./errors.js";
import { DisplayMemory, PendingEstops } from "./memory.js";
import { API_VERSION, MSGPACK_PROTOCOL, PATH } from "./messages.js";
import { DecodeError, decode, encode } from "./msgpack.js";
import { StreamPacing } from "./pacing.js";
import { faultOf, isKnown, isTyped } from "./validation.js";
/** Interval between pings, each of which also measures the clocks [ms]. */
const PING_INTERVAL_MS = 1000;
/** Time without an answer to what is answered at once, after which a connection is given up [µs]. */
const SILENCE_US = 3e6;
/** Requests that the server answers at once, whatever else it does. */
const PROMPT = ["ping", "estop"];
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
const FINAL_CODES = new Set([1002, 4400, 4401, 4406]);
/** Types of these replies. */
const REPLIES = {
    hello: "welcome",
    list_textures: "textures",
    draw_texture: "texture_picture",
    list_effects: "effects",
    append: "appended",
    get_stats: "stats",
    ping: "pong",
};
/**
 * Connect to a server, and again whenever the connection is lost, until `close` is called.
 *
 * @returns The connection at once; `ready()` waits for the server.
 */
export function connect(options = {}) {
    return new Connection(options);
}
/** Connection to a server over any number of WebSockets. */
export class Connection {
    constructor(options = {}) {
        this.options = options;
        /** State of the connection. */
        this.state = "connecting";
        /** Why there is no connection, in a sentence; empty while there is one. */
        this.reason = "not connected yet";
        /** Number of messages of the server that are not as the API has them. */
        this.ignoredMessages = 0;
        this.opened_us = 0;
        this.refusal = "";
        this.waiting = new Map();
        this.lastId = 0;
        this.pause_ms = FIRST_PAUSE_MS;
        this.clock = new ClockOffset();
        this.pacing = new StreamPacing(0);
        this.estops = new PendingEstops();
        this.memories = new Map();
        this.known = new Map();
        this.listeners = {
            state: new Set(),
            event: new Set(),
            onset: new Set(),
            failure: new Set(),
        };
        this.url = options.url ?? ownServer();
        this.pinging = setInterval(() => this.checkAlive(), PING_INTERVAL_MS);
        this.open();
    }
    /** Duration of the quickest of the last exchanges with the server [ms], if there was one. */
    get roundTrip_ms() {
        const roundTrip_us = this.clock.roundTrip_us;
        return roundTrip_us === undefined ? undefined : roundTrip_us / 1000;
    }
    /** Return the present time of the server's monotonic clock [µs], if it is known. */
    serverTime_us() {
        const offset_us = this.clock.offset_us;
        return offset_us === undefined ? undefined : now_us() + offset_us;
    }
    /** Displays of the server. */
    get displays() {
        return (this.welcome?.displays ?? []).map(({ name }) => this.displayNamed(name));
    }
    /**
     * Return a display of the server.
     *
     * @param name Name of the display, by default that of the first one. Throws if there is none.
     */
    display(name) {
        const displays = this.displays;
        const chosen = displays.find((display) => name === undefined || display.name === name);
        if (chosen !== undefined)
            return chosen;
        const names = displays.map((display) => display.name).join(", ") || "none yet";
        throw new ClientError(`no display ${JSON.stringify(name ?? "")}; there are: ${names}`);
    }
    /** Wait until the server has admitted this client; rejected if it refuses it. */
    ready() {
        return new Promise((resolve, reject) => {
            const settle = () => {
                if (this.state === "connected" && this.welcome)
                    resolve(this.welcome);
                else if (this.state !== "connecting")
                    reject(new DisconnectedError(this.reason));
                return this.state !== "connecting";
            };
            if (settle())
                return;
            const remove = this.on("state", () => {
                if (settle())
                    remove();
            });
        });
    }
    /** Return all textures of the server. */
    async textures() {
        return (await this.request({ type: "list_textures" })).textures;
    }
    /**
     * Return a picture of the surface of a texture, which may take a second.
     *
     * @param section Texture, and what to draw of it.
     */
    async drawTexture(section) {
        const picture = await this.request({ type: "draw_texture", ...section });
        const [wanted, sent] = [section.columns * section.rows, picture.pixels.length];
        if (sent !== wanted)
            throw new ClientError(`the picture has ${sent} pixels, not ${wanted}`);
        return picture;
    }
    /** Return all effects of the server. */
    async effects() {
        return (await this.request({ type: "list_effects" })).effects;
    }
    /**
     * Set all displays to 0 V at once, until each is cleared; see `Display.estop`.
     *
     * @returns Number of the e-stop by name of the display.
     */
    async estop() {
        return (await this.request({ type: "estop" })).estops ?? {};
    }
    /**
     * Call a function with each change of the state, each event, each report on what was to begin at
     * a time, or each failure that answers no request, such as that of a contact that cannot be used.
     *
     * @returns Function that ends it.
     */
    on(kind, listener) {
        this.listeners[kind].add(listener);
        return () => this.listeners[kind].delete(listener);
    }
    /** End the connection; nothing is answered any more. */
    close() {
        clearInterval(this.pinging);
        clearTimeout(this.retry);
        this.lost("closed by this program", "closed");
    }
    /** Send a request and wait for its answer; `Display` has a method for each. */
    request(command) {
        const quieter = ["estop", "disarm", "stop"].includes(command.type);
        if (this.state !== "connected") {
            if (command.type === "estop")
                this.estops.add(command, 0);
            return Promise.reject(this.disconnected(command));
        }
        if (this.waiting.size >= MOST_WAITING && !quieter) {
            const text = `${MOST_WAITING} requests are already waiting for an answer`;
            return Promise.reject(new ClientError(text));
        }
        return this.send(command);
    }
    /** Send a contact, or count it if that is not possible now. */
    sendContact(contact) {
        if (!this.stream(contact, contact.normal_force_n === 0)) {
            this.memory(contact.display).droppedContacts += 1;
        }
    }
    /** Send tactile frames, or count the message if that is not possible now. */
    sendFrames(frames) {
        if (!this.stream(frames, false))
            this.memory(frames.display).droppedFrames += 1;
    }
    /** Send a message of a stream if that is possible now, and return whether it was. */
    stream(message, urgent) {
        if (this.state !== "connected" || this.socket === undefined)
            return false;
        const late = this.socket.bufferedAmount > MOST_UNSENT;
        if (!urgent && (late || !this.pacing.take(now_us())))
            return false;
        this.socket.send(encode(message));
        return true;
    }
    /** Return what outlasts a connection of one display. */
    memory(display) {
        let memory = this.memories.get(display);
        if (memory === undefined) {
            memory = new DisplayMemory();
            this.memories.set(display, memory);
        }
        return memory;
    }
    /** Call a function with telemetry of a display; return the function that ends it. */
    subscribe(display, wanted, listener) {
        const memory = this.memory(display);
        const update = () => {
            if (this.state === "connected")
                this.sendUnasked(memory.subscription(display));
        };
        memory.listeners.delete(listener); // what is wanted last comes last
        memory.listeners.set(listener, wanted);
        update();
        return () => {
            memory.listeners.delete(listener);
            update();
        };
    }
    displayNamed(name) {
        let display = this.known.get(name);
        if (display === undefined) {
            display = new Display(this, name);
            this.known.set(name, display);
        }
        return display;
    }
    // Opening and losing a WebSocket
    open() {
        const Socket = this.options.webSocket ?? globalThis.WebSocket;
        if (Socket === undefined) {
            this.lost("there is no WebSocket here: pass `webSocket`, such as that of `ws`", "refused");
            return;
        }
        this.refusal = "";
        let socket;
        try {
            socket = new Socket(this.url, MSGPACK_PROTOCOL);
        }
        catch (error) {
            this.lost(`cannot connect to ${this.url}: ${error.message}`, "refused");
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
    sayHello() {
        this.waiting.clear();
        const { client = "tactile-client", token = "" } = this.options;
        this.send({ type: "hello", client, version: API_VERSION, token }).catch((error) => {
            if (error instanceof RequestError)
                this.refusal = error.message; // it is closed next
        });
    }
    closed(code, reason) {
        const text = this.refusal || reason || `the server at ${this.url} does not answer`;
        this.lost(text, FINAL_CODES.has(code) ? "refused" : "connecting");
    }
    lost(reason, state) {
        if (this.state === "closed" || this.state === "refused")
            return;
        const socket = this.socket;
        this.socket = undefined;
        this.state = state;
        this.reason = reason;
        this.estops.disconnect();
        const waiting = [...this.waiting.values()];
        this.waiting.clear();
        for (const { command, reject } of waiting)
            reject(this.disconnected(command));
        socket?.close();
        if (state === "connecting")
            this.openLater();
        else
            clearInterval(this.pinging);
        this.notify("state", this);
    }
    openLater() {
        const pause_ms = this.pause_ms * (1 - Math.random() / 2);
        this.pause_ms = Math.min(2 * this.pause_ms, LONGEST_PAUSE_MS);
        this.retry = setTimeout(() => this.open(), pause_ms);
    }
    disconnected(command) {
        const kept = command.type === "estop" && this.state === "connecting";
        const text = kept ? "; the e-stop is kept and will be sent first when the server is back" : "";
        return new DisconnectedError(`not connected: ${this.reason}${text}`);
    }
    checkAlive() {
        const now = now_us();
        const isLate = ({ command, sent_us }) => PROMPT.includes(command.type) && now - sent_us > SILENCE_US;
        if (this.state === "connecting") {
            const isOpening = this.socket !== undefined;
            if (!isOpening || now - this.opened_us < WELCOME_WITHIN_US)
                return;
            this.lost(this.refusal || "the server does not answer", "connecting");
        }
        else if (this.state === "connected") {
            this.giveUpStats(now - STATS_WITHIN_US);
            if ([...this.waiting.values()].some(isLate)) {
                this.lost("the server does not answer", "connecting");
            }
            else {
                this.sendUnasked({ type: "ping", time_us: now });
            }
        }
    }
    /** Reject questions for the state that are older than a time: their answers may be lost. */
    giveUpStats(oldest_us) {
        for (const [id, { command, sent_us, reject }] of [...this.waiting]) {
            if (command.type !== "get_stats" || sent_us > oldest_us)
                continue;
            this.waiting.delete(id);
            reject(new ClientError("the server does not answer"));
        }
    }
    // Messages
    send(command) {
        const id = (this.lastId += 1);
        return new Promise((resolve, reject) => {
            this.waiting.set(id, { command, sent_us: now_us(), resolve, reject });
            if (command.type === "estop")
                this.estops.add(command, id);
            this.socket?.send(encode({ ...command, id }));
        });
    }
    /** Send a request of the client's own; what is wrong with it is a failure without a request. */
    sendUnasked(command) {
        this.send(command).catch((error) => {
            if (error instanceof RequestError)
                this.notify("failure", error.failure);
        });
    }
    receive(data) {
        const message = decoded(data);
        const fault = message && faultOf(message);
        if (message === undefined)
            this.giveUp("the server sends what is no message");
        else if (fault)
            this.takeFaulty(message, fault);
        else
            this.take(message);
    }
    take(answer) {
        if (answer.type === "telemetry") {
            for (const listener of [...(this.memories.get(answer.display)?.listeners.keys() ?? [])]) {
                call(listener, answer);
            }
        }
        else if (answer.type === "event") {
            if (answer.kind === "estopped")
                this.setEstop(answer.display, answer.estop ?? 0);
            if (answer.kind === "cleared")
                this.setEstop(answer.display, 0);
            this.notify("event", answer);
        }
        else if (answer.type === "onset") {
            this.notify("onset", answer);
        }
        else if (answer.id === undefined || answer.id === null) {
            if (answer.type === "failure")
                this.notify("failure", answer);
            else
                this.giveUp(`the server sends ${answer.type} without an id`);
        }
        else {
            this.answered({ ...answer, id: answer.id });
        }
    }
    /**
     * Take a message that is not as the API has it. If it is an answer, its request fails. All others
     * are ignored, unless a request could wait for them for ever.
     */
    takeFaulty({ type, id }, fault) {
        const text = `${type} of the server cannot be read: ${fault}`;
        const waiting = this.waiting.get(id);
        const { type: asked = "" } = waiting?.command ?? {};
        if (asked === "hello" || asked === "estop") { // an e-stop is sent again
            this.giveUp(text);
        }
        else if (waiting !== undefined) {
            this.ignoredMessages += 1;
            const message = text;
            this.answered({ type: "failure", id: id, code: "internal", message });
        }
        else if (isKnown(type) && !["event", "onset", "telemetry"].includes(type) && !Number.isInteger(id)) {
            this.giveUp(text);
        }
        else {
            this.ignoredMessages += 1;
        }
    }
    /** Connect anew, as an answer may be lost for which a request would wait. */
    giveUp(reason) {
        this.ignoredMessages += 1;
        this.lost(reason, "connecting");
    }
    setEstop(display, estop) {
        const memory = this.memories.get(display); // those of displays that the welcome had
        if (memory)
            memory.estop = estop;
    }
    answered(answer) {
        const { id } = answer;
        const waiting = this.waiting.get(id);
        if (waiting === undefined)
            return;
        const { type } = waiting.command;
        const expected = type in REPLIES ? REPLIES[type] : "done";
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
    learn(answer, { command, sent_us }) {
        if (answer.type === "welcome") {
            this.welcomedBy(answer, sent_us);
        }
        else if (answer.type === "pong") {
            this.clock.add(sent_us, answer.server_time_us, now_us());
        }
        else if (answer.type === "stats") {
            this.setEstop(answer.display, answer.estop ?? 0);
        }
        else if (answer.type === "done") {
            for (const [display, estop] of Object.entries(answer.estops ?? {})) {
                this.setEstop(display, estop);
            }
            if ("display" in command && command.display)
                this.memory(command.display).confirm(command);
        }
    }
    /** Send unconfirmed e-stops first, then what restores the state; nothing arms. */
    welcomedBy(welcome, sent_us) {
        this.welcome = welcome;
        this.clock = new ClockOffset();
        this.clock.add(sent_us, welcome.time_us, now_us());
        this.pacing = new StreamPacing(welcome.messages_per_second ?? 0);
        this.pause_ms = FIRST_PAUSE_MS;
        for (const { name, estop } of welcome.displays)
            this.memory(name).estop = estop ?? 0;
        for (const estop of this.estops.unsent())
            this.sendUnasked(estop);
        for (const [display, memory] of this.memories) {
            for (const command of memory.restoring(display))
                this.sendUnasked(command);
        }
        this.state = "connected";
        this.reason = "";
        this.notify("state", this);
    }
    notify(kind, value) {
        for (const listener of [...this.listeners[kind]])
            call(listener, value);
    }
}
/** Return a message; undefined for what is none. */
function decoded(data) {
    if (typeof data === "string")
        return undefined;
    try {
        const value = decode(new Uint8Array(data));
        return isTyped(value) ? value : undefined;
    }
    catch (error) {
        if (!(error instanceof DecodeError))
            throw error;
        return undefined;
    }
}
/** Call a listener; what it throws is reported, and harms no other one. */
function call(listener, value) {
    try {
        listener(value);
    }
    catch (error) {
        queueMicrotask(() => {
            throw error;
        });
    }
}
/** Return the address of the server that this page came from. */
function ownServer() {
    if (typeof location === "undefined")
        throw new ClientError("url: is needed outside of a page");
    return `${location.protocol === "https:" ? "wss:" : "ws:"}//${location.host}${PATH}`;
}
