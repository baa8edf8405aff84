/** What outlasts a connection: what the program wants each display to play, and e-stops. */
/** What a client knows of one display, and wants of it. */
export class DisplayMemory {
    constructor() {
        /** Number of the e-stop that holds as far as the server last reported, 0 for none. */
        this.estop = 0;
        /** Number of contacts that were not sent. */
        this.droppedContacts = 0;
        /** Number of messages of tactile frames that were not sent. */
        this.droppedFrames = 0;
        /** Listeners for telemetry, with what each wants. */
        this.listeners = new Map();
        this.wanted = new Map();
    }
    /** Remember a request that was carried out, if it is to be repeated after a reconnection. */
    confirm(command) {
        if (command.type === "select" || command.type === "gain" || command.type === "stop") {
            this.wanted.set(command.type, command);
        }
        else if (command.type === "play") {
            this.wanted.delete("stop");
        }
    }
    /** Return the subscription that gives all listeners their rate, and the last one its contactor. */
    subscription(display) {
        const wanted = [...this.listeners.values()];
        const rate_hz = Math.max(0, ...wanted.map((one) => one.rate_hz));
        const contactors = wanted.map((one) => one.contactor).filter((one) => one !== undefined);
        return { type: "subscribe", display, rate_hz, contactor: contactors[contactors.length - 1] ?? null };
    }
    /** Return the requests that restore the state after a reconnection; none of them arms. */
    restoring(display) {
        return [
            ...this.wanted.values(),
            ...(this.listeners.size > 0 ? [this.subscription(display)] : []),
        ];
    }
}
/** E-stops that the server has not confirmed. */
export class PendingEstops {
    constructor() {
        /** Id of the newest request by display, undefined for all displays; 0 if it must be sent. */
        this.requests = new Map();
    }
    /** Keep an e-stop until it is confirmed. */
    add(command, id) {
        this.requests.set(command.display ?? undefined, id);
    }
    /** Take all e-stops that were not confirmed as not sent. */
    disconnect() {
        for (const display of this.requests.keys())
            this.requests.set(display, 0);
    }
    /** Return the e-stops that are to be sent first over a new connection. */
    unsent() {
        const displays = [...this.requests].filter(([, id]) => id === 0).map(([display]) => display);
        return displays.map((display) => display === undefined ? { type: "estop" } : { type: "estop", display });
    }
    /** Forget the e-stop that an answer is about, unless it was refused and must be sent again. */
    resolve(answer) {
        for (const [display, id] of this.requests) {
            if (id !== answer.id)
                continue;
            const ended = answer.type !== "failure" || answer.code === "unknown_display";
            if (ended)
                this.requests.delete(display);
            else
                this.requests.set(display, 0);
        }
    }
}
