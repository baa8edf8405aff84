import { Signal } from "./signal.js";

const dark = matchMedia("(prefers-color-scheme: dark)");
const still = matchMedia("(prefers-reduced-motion: reduce)");

/** Return whether the user wants as little motion as possible. */
export function wantsStillness(): boolean {
  return still.matches;
}

/** Return whether the page is dark. */
export function isDark(): boolean {
  return dark.matches;
}

/** Colors that are drawn with. style.css defines them, for light and dark. */
export interface Colors {
  text: string;
  muted: string;
  line: string;
  accent: string;
  drive: string;
  panel: string;
}

function readColors(): Colors {
  const style = getComputedStyle(document.documentElement);
  const color = (name: string) => style.getPropertyValue(`--${name}`).trim();
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
  /** Emitted when the size or the colors have changed, so that all must be drawn again. */
  readonly changed = new Signal<Drawing>();
  readonly context: CanvasRenderingContext2D;
  /** Size in CSS pixels. */
  width = 0;
  height = 0;
  colors = readColors();

  constructor(readonly canvas: HTMLCanvasElement) {
    this.context = canvas.getContext("2d") as CanvasRenderingContext2D;
    new ResizeObserver(() => this.resize(canvas.clientWidth, canvas.clientHeight)).observe(canvas);
    const redraw = () => {
      this.colors = readColors();
      this.changed.emit(this);
    };
    dark.addEventListener("change", redraw);
    still.addEventListener("change", redraw);
  }

  /** Make the whole canvas transparent. */
  clear(): void {
    this.context.clearRect(0, 0, this.width, this.height);
  }

  private resize(width: number, height: number): void {
    const ratio = window.devicePixelRatio;
    [this.width, this.height] = [width, height];
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.changed.emit(this);
  }
}

/** Call a function before each frame with its time [ms], as long as the page is shown. */
export function onEachFrame(draw: (time_ms: number) => void): void {
  const frame = (time_ms: number) => {
    requestAnimationFrame(frame);
    draw(time_ms);
  };
  requestAnimationFrame(frame);
}
