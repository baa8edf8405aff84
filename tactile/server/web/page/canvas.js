import { Signal } from "./signal.js";
const dark = matchMedia("(prefers-color-scheme: dark)");
const still = matchMedia("(prefers-reduced-motion: reduce)");
/** Return whether the user wants as little motion as possible. */
export function wantsStillness() {
    return still.matches;
}
/** Return whether the page is dark. */
export function isDark() {
    return dark.matches;
}
function readColors() {
    const style = getComputedStyle(document.documentElement);
    const color = (name) => style.getPropertyValue(`--${name}`).trim();
    return {
        text: color("text"),
        muted: color("muted"),
        line: color("line"),
        accent: color("accent"),
        drive: color("drive"),
        panel: color("panel"),
    };
}
/** A canvas as large as its box on the page, drawn in CSS pixels at the screen's resolution. */
export class Drawing {
    constructor(canvas) {
        this.canvas = canvas;
        /** Emitted when the size or the colors have changed, so that all must be drawn again. */
        this.changed = new Signal();
        /** Size in CSS pixels. */
        this.width = 0;
        this.height = 0;
        this.colors = readColors();
        this.context = canvas.getContext("2d");
        new ResizeObserver(() => this.resize(canvas.clientWidth, canvas.clientHeight)).observe(canvas);
        const redraw = () => {
            this.colors = readColors();
            this.changed.emit(this);
        };
        dark.addEventListener("change", redraw);
        still.addEventListener("change", redraw);
    }
    /** Make the whole canvas transparent. */
    clear() {
        this.context.clearRect(0, 0, this.width, this.height);
    }
    resize(width, height) {
        const ratio = window.devicePixelRatio;
        [this.width, this.height] = [width, height];
        this.canvas.width = Math.round(width * ratio);
        this.canvas.height = Math.round(height * ratio);
        this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
        this.changed.emit(this);
    }
}
/** Call a function before each frame with its time [ms], as long as the page is shown. */
export function onEachFrame(draw) {
    const frame = (time_ms) => {
        requestAnimationFrame(frame);
        draw(time_ms);
    };
    requestAnimationFrame(frame);
}
