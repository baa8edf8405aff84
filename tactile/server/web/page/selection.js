import { Newest } from "./newest.js";
import { Signal } from "./signal.js";
import { texts } from "./texts.js";
const NOTHING = { left: "", right: "" };
/**
 * Textures that the pad has, one for all of it or one for each half.
 *
 * The display has both textures ready, the one under the finger with gain 1 and the other with
 * gain 0, so that a finger that crosses the middle changes between them in a cross-fade.
 */
export class Selection {
    constructor(session) {
        this.session = session;
        /** Emitted when the halves of the display that is shown have other textures. */
        this.changed = new Signal();
        /** Emitted when the server has answered, with the texture and the error if there was one. */
        this.settled = new Signal();
        this.played = new Map();
        this.wishes = new Map();
        this.half = "left";
        this.wasConnected = false;
        this.requests = new Newest((wish) => this.request(wish), (wish, error) => this.settle(wish, error));
        session.displayChanged.on(() => {
            this.changed.emit(this);
            this.playHalf();
        });
        session.changed.on(({ isConnected }) => {
            if (isConnected && !this.wasConnected)
                this.playHalf();
            this.wasConnected = isConnected;
        });
        session.reopened.on(() => {
            this.played.clear(); // the server forgot it with the connection
            this.wishes.clear();
            this.changed.emit(this);
        });
    }
    /** Textures that the display plays. */
    get halves() {
        return this.played.get(this.session.display?.name ?? "") ?? NOTHING;
    }
    /** Whether the halves have two textures. */
    get isDivided() {
        return this.halves.right !== "";
    }
    /** Let the pad have a texture, in its left half if the halves have two. */
    choose(name) {
        this.wish(name, (halves) => ({ ...halves, left: name }));
    }
    /** Let the right half of the pad have a texture of its own, or with "" that of the left one. */
    chooseBeside(name) {
        this.wish(name, (halves) => ({ ...halves, right: name }));
    }
    /** Play the texture of the half that the finger is in. */
    enter(half) {
        if (half === this.half)
            return;
        this.half = half;
        this.playHalf();
    }
    /** Have the display play what the half has, also if it missed that or was not shown then. */
    playHalf() {
        const wish = this.wishes.get(this.session.display?.name ?? "");
        if (wish?.halves.right)
            this.requests.send(wish);
    }
    wish(name, change) {
        const display = this.session.display?.name ?? "";
        const halves = change(this.wishes.get(display)?.halves ?? NOTHING);
        const wish = { display, halves, name: name || halves.left };
        this.wishes.set(display, wish);
        this.requests.send(wish);
    }
    async request({ display, halves }) {
        if (!display)
            throw new Error(texts.notConnected);
        await this.session.connection.display(display).select(layers(halves, this.half));
        const { left, right } = this.played.get(display) ?? NOTHING;
        this.played.set(display, halves);
        if (left !== halves.left || right !== halves.right)
            this.changed.emit(this);
    }
    settle(wish, error) {
        const { display, name } = wish;
        const halves = this.played.get(display);
        if (error && halves)
            this.wishes.set(display, { ...wish, halves });
        else if (error)
            this.wishes.delete(display);
        this.settled.emit({ name, error });
    }
}
function layers({ left, right }, half) {
    if (right === "" || right === left)
        return [{ texture: left }];
    return [
        { texture: left, gain: half === "left" ? 1 : 0 },
        { texture: right, gain: half === "left" ? 0 : 1 },
    ];
}
