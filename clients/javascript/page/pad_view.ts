import { Drawing, onEachFrame } from "./canvas.js";
import { byId, setText } from "./dom.js";
import { Finger, MM_PER_PIXEL } from "./finger.js";
import { texts } from "./texts.js";

/** Time for which the trace is shown [ms]. */
const TRACE_MS = 500;
/** Diameter of the circle that stands for the finger [mm]. Assumed: a fingertip's contact. */
const FINGER_MM = 10;
const READ_EVERY_MS = 100;
/** Points of the trace that are drawn with the same opacity. */
const POINTS_PER_STEP = 24;

/** Shows the finger on the pad with its trace, and its position, speed and force as text. */
export class PadView {
  private readonly drawing: Drawing;
  private isStale = true;

  constructor(canvas: HTMLCanvasElement, private readonly finger: Finger) {
    this.drawing = new Drawing(canvas);
    this.drawing.changed.on(() => (this.isStale = true));
    onEachFrame((time_ms) => this.draw(time_ms));
    const reading = byId("pad-reading");
    setInterval(() => setText(reading, this.reading()), READ_EVERY_MS);
  }

  private reading(): string {
    const { finger } = this;
    if (!finger.touching) return texts.lifted;
    const speed_mm_s = finger.speed_mm_s(performance.now());
    return texts.finger(finger.x_mm, finger.y_mm, speed_mm_s, finger.force_n);
  }

  private draw(time_ms: number): void {
    const first = this.finger.firstPointSince(time_ms - TRACE_MS);
    const hasTrace = first < this.finger.points;
    if (!this.isStale && !hasTrace && !this.finger.touching) return;
    this.isStale = hasTrace || this.finger.touching;
    this.drawing.clear();
    this.drawTrace(first, time_ms);
    if (this.finger.touching) this.drawFinger();
  }

  private drawTrace(first: number, time_ms: number): void {
    const { context, colors } = this.drawing;
    context.strokeStyle = colors.accent;
    context.lineWidth = 3;
    context.lineJoin = context.lineCap = "round";
    for (let begin = first; begin < this.finger.points - 1; begin += POINTS_PER_STEP) {
      const end = Math.min(begin + POINTS_PER_STEP, this.finger.points - 1);
      const age_ms = time_ms - this.finger.point(end).time_ms;
      context.globalAlpha = Math.max(0, 0.8 * (1 - age_ms / TRACE_MS));
      context.beginPath();
      for (let k = begin; k <= end; k++) this.lineTo(k);
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  private lineTo(number: number): void {
    const { x_mm, y_mm } = this.finger.point(number);
    this.drawing.context.lineTo(x_mm / MM_PER_PIXEL, this.drawing.height - y_mm / MM_PER_PIXEL);
  }

  private drawFinger(): void {
    const { context, height, colors } = this.drawing;
    const [x, y] = [this.finger.x_mm / MM_PER_PIXEL, height - this.finger.y_mm / MM_PER_PIXEL];
    context.beginPath();
    context.arc(x, y, FINGER_MM / 2 / MM_PER_PIXEL, 0, 2 * Math.PI);
    context.fillStyle = context.strokeStyle = colors.accent;
    context.lineWidth = 2;
    context.globalAlpha = 0.25;
    context.fill();
    context.globalAlpha = 1;
    context.stroke();
  }
}
