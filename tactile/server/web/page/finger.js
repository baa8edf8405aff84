import { Signal } from "./signal.js";
/** Length of a CSS pixel, by definition [mm]. */
export const MM_PER_PIXEL = 25.4 / 96;
/** Normal force at the largest pressure of a pointer [N]. Assumed: a firm stroke. */
const FULL_FORCE_N = 1;
/** Pressure of a pointer that does not measure it, as the W3C's Pointer Events have it. */
export const PRESSURE_OF_A_MOUSE = 0.5;
/** Time between contacts of a finger that rests [ms]; the server gives it up after 100 ms. */
const REPEAT_MS = 30;
/** Points of the trace that are kept: more than half a second of a mouse with 1000 Hz. */
const MOST_POINTS = 1024;
/** Time over which the shown speed is a mean [ms]. */
const SPEED_MS = 60;
/** One position of the finger, with its time on the clock of `performance.now()`. */
class TracePoint {
    constructor() {
        this.x_mm = 0;
        this.y_mm = 0;
        this.time_ms = 0;
    }
}
/** The finger of this page: sends contacts to the display, and keeps the trace of the last ones. */
export class Finger {
    constructor(session) {
        this.session = session;
        /** Emitted when the finger touches or lifts. */
        this.changed = new Signal();
        /** Emitted at each position, before the contact is sent. */
        this.moved = new Signal();
        this.touching = false;
        this.x_mm = 0;
        this.y_mm = 0;
        this.force_n = 0;
        /** Number of points of the trace so far. */
        this.points = 0;
        this.trace = Array.from({ length: MOST_POINTS }, () => new TracePoint());
        this.first = 0;
        this.latest_us = -Infinity;
        /** Time from the last event to its handling: a screen may hand its touches over 40 ms late. */
        this.delay_ms = 0;
        setInterval(() => this.repeat(), REPEAT_MS);
        // The contacts of one display are not those of another one.
        session.displayChanged.on(() => this.lift(performance.now()));
    }
    /** Touch at a position, or move there. */
    touch(x_mm, y_mm, pressure, time_ms) {
        this.delay_ms = Math.max(0, performance.now() - time_ms);
        if (!this.touching) {
            this.first = this.points;
            this.display = this.session.display;
        }
        [this.x_mm, this.y_mm, this.force_n] = [x_mm, y_mm, pressure * FULL_FORCE_N];
        this.moved.emit(this);
        // `pointermove` repeats what `pointerrawupdate` has reported, with the same times.
        const isNew = this.send(time_ms);
        if (isNew)
            this.addPoint(time_ms);
        if (this.touching)
            return;
        this.touching = true;
        this.changed.emit(this);
    }
    /** Leave the surface. */
    lift(time_ms) {
        if (!this.touching)
            return;
        this.touching = false;
        this.latest_us = Math.max(Math.round(time_ms * 1000), this.latest_us + 1);
        if (this.isWanted)
            this.display?.lift(this.latest_us);
        this.changed.emit(this);
    }
    /** Return the mean speed of the last few milliseconds [mm/s], 0 for a finger that rests. */
    speed_mm_s(time_ms) {
        if (!this.touching || this.points === this.first)
            return 0;
        const newest = this.point(this.points - 1);
        let [k, path_mm, after] = [this.points - 2, 0, newest];
        for (; k >= this.first && time_ms - after.time_ms < SPEED_MS; k--) {
            const before = this.point(k);
            path_mm += Math.hypot(after.x_mm - before.x_mm, after.y_mm - before.y_mm);
            after = before;
        }
        return (1000 * path_mm) / Math.max(time_ms - after.time_ms, SPEED_MS / 4);
    }
    /** Return a point of the trace by its number. Only the newest ones still exist. */
    point(number) {
        return this.trace[number % MOST_POINTS];
    }
    /** Return the number of the first point of this stroke that is younger than an age [ms]. */
    firstPointSince(time_ms) {
        const oldest = Math.max(0, this.first, this.points - MOST_POINTS);
        let number = this.points;
        while (number > oldest && this.point(number - 1).time_ms >= time_ms)
            number--;
        return number;
    }
    /** Whether the server takes contacts now. It would close the connection after many failures. */
    get isWanted() {
        const { session } = this;
        return session.may("play") && (session.state === "armed" || session.state === "disarmed");
    }
    send(time_ms) {
        const time_us = Math.round(time_ms * 1000);
        if (time_us <= this.latest_us)
            return false;
        this.latest_us = time_us;
        const options = { normal_force_n: this.force_n, time_us };
        if (this.isWanted)
            this.display?.touch([this.x_mm, this.y_mm], options);
        return true;
    }
    repeat() {
        // The place is known up to the last event that was handled. With a later time, the server would
        // drop the events that are still on their way.
        const known_ms = performance.now() - this.delay_ms;
        if (!this.touching || known_ms * 1000 - this.latest_us < REPEAT_MS * 900)
            return;
        if (this.send(known_ms))
            this.addPoint(known_ms);
    }
    addPoint(time_ms) {
        const point = this.point(this.points++);
        [point.x_mm, point.y_mm, point.time_ms] = [this.x_mm, this.y_mm, time_ms];
    }
}
