import { MM_PER_PIXEL, PRESSURE_OF_A_MOUSE } from "./finger.js";
import { onLeaving } from "./pad_pointer.js";
const SPEED_MM_S = 60;
const FAST_MM_S = 150;
/** Time between contacts while a key is held [ms]. */
const STEP_MS = 8;
const DIRECTIONS = {
    ArrowLeft: [-1, 0],
    ArrowRight: [1, 0],
    ArrowUp: [0, 1],
    ArrowDown: [0, -1],
};
/** Moves the finger at a constant speed while arrow keys are held; Space touches at rest. */
export class PadKeys {
    constructor(pad, finger) {
        this.pad = pad;
        this.finger = finger;
        this.held = new Set();
        this.isFast = false;
        this.rests = false;
        this.timer = 0;
        this.stepped_ms = 0;
        pad.addEventListener("keydown", (event) => this.press(event));
        pad.addEventListener("keyup", (event) => this.release(event));
        pad.addEventListener("blur", () => this.leave());
        onLeaving(() => this.leave());
        finger.changed.on(() => {
            if (!finger.touching)
                this.rests = false; // a pointer has lifted the finger
        });
    }
    press(event) {
        if (event.ctrlKey || event.altKey || event.metaKey)
            return;
        const isArrow = event.key in DIRECTIONS;
        if (!isArrow && event.key !== " " && event.key !== "Shift")
            return;
        this.isFast = event.shiftKey;
        if (event.key === "Shift")
            return;
        event.preventDefault(); // it would scroll the page
        if (event.repeat)
            return;
        if (isArrow)
            this.hold(event.key);
        else
            this.toggleRest();
    }
    release(event) {
        this.isFast = event.shiftKey;
        if (!this.held.delete(event.key) || this.held.size > 0)
            return;
        this.step();
        this.stopMoving();
        if (!this.rests)
            this.finger.lift(performance.now());
    }
    hold(key) {
        this.held.add(key);
        if (this.timer)
            return;
        this.stepped_ms = performance.now();
        this.timer = window.setInterval(() => this.step(), STEP_MS);
        this.touch(this.finger.x_mm, this.finger.y_mm, this.stepped_ms);
    }
    toggleRest() {
        this.rests = !this.rests;
        const now_ms = performance.now();
        if (this.rests)
            this.touch(this.finger.x_mm, this.finger.y_mm, now_ms);
        else if (this.held.size === 0)
            this.finger.lift(now_ms);
    }
    step() {
        const now_ms = performance.now();
        const way_mm = ((this.isFast ? FAST_MM_S : SPEED_MM_S) * (now_ms - this.stepped_ms)) / 1000;
        this.stepped_ms = now_ms;
        let [x, y] = [0, 0];
        for (const key of this.held) {
            const [right, up] = DIRECTIONS[key] ?? [0, 0];
            x += right;
            y += up;
        }
        const step_mm = way_mm / (Math.hypot(x, y) || 1); // no faster along a diagonal
        this.touch(this.finger.x_mm + x * step_mm, this.finger.y_mm + y * step_mm, now_ms);
    }
    touch(x_mm, y_mm, time_ms) {
        const x = clamp(x_mm, this.pad.clientWidth * MM_PER_PIXEL);
        const y = clamp(y_mm, this.pad.clientHeight * MM_PER_PIXEL);
        this.finger.touch(x, y, PRESSURE_OF_A_MOUSE, time_ms);
    }
    leave() {
        if (this.held.size === 0 && !this.rests)
            return;
        this.held.clear();
        this.rests = false;
        this.stopMoving();
        this.finger.lift(performance.now());
    }
    stopMoving() {
        clearInterval(this.timer);
        this.timer = 0;
    }
}
function clamp(value, largest) {
    return Math.min(Math.max(value, 0), largest);
}
