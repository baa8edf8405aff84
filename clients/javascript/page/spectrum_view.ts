import { Drawing, onEachFrame } from "./canvas.js";
import type { BandShear } from "./contactor_spectrum.js";
import { texts } from "./texts.js";
import { BANDS } from "./third_octaves.js";
import { Threshold } from "./threshold.js";

/** Smallest and largest shear of the axis [µm]. */
const [LEAST_UM, MOST_UM] = [0.01, 100];
/** Lowest and highest frequency of the axis [Hz]: the edges of the bands. */
const [LOWEST_HZ, HIGHEST_HZ] = [10 ** 0.95, 10 ** 3.05];
const SHEARS_UM = [0.01, 0.1, 1, 10, 100];
/** Frequencies of the grid; where space is scarce, only the first ones are named. */
const FREQUENCIES_HZ = [10, 1000, 100, 20, 500, 50, 200];
/** Opacity of a bar below and above threshold. */
const [PALE, FULL] = [0.35, 1];
/** Distance between texts and lines, and between bars [CSS px]. */
const [GAP, BAR_GAP] = [5, 1];

/** A rectangle [CSS px]. */
interface Plot {
  readonly left: number;
  readonly right: number;
  readonly top: number;
  readonly bottom: number;
}

/** Draws third octaves of shears, and the detection threshold, on logarithmic axes. */
export class SpectrumView {
  private readonly drawing: Drawing;
  private bands: readonly BandShear[] = [];
  private played: readonly BandShear[] = [];
  private threshold = new Threshold([]);
  private isStale = true;
  private plot: Plot = { left: 0, right: 0, top: 0, bottom: 0 };

  constructor(canvas: HTMLCanvasElement) {
    this.drawing = new Drawing(canvas);
    this.drawing.changed.on(() => (this.isStale = true));
    onEachFrame(() => this.draw());
  }

  /** Show the bands of commanded and played shear, none for nothing, and a threshold. */
  show(
    bands: readonly BandShear[],
    played: readonly BandShear[],
    threshold: Threshold,
  ): void {
    if (bands === this.bands && played === this.played && threshold === this.threshold) return;
    [this.bands, this.played, this.threshold, this.isStale] = [bands, played, threshold, true];
  }

  private draw(): void {
    if (!this.isStale) return;
    this.isStale = false;
    const { context, canvas } = this.drawing;
    this.drawing.clear();
    const { fontSize, fontFamily } = getComputedStyle(canvas);
    context.font = `${fontSize} ${fontFamily}`;
    this.fit(parseFloat(fontSize));
    this.drawGrid();
    this.drawBars();
    this.drawPlayed();
    this.drawThreshold();
    const { right, top } = this.plot;
    const name = this.played.length ? texts.barsAndPlayed : texts.bars;
    this.drawName(name, right - GAP, top + 1.5 * parseFloat(fontSize), "right");
  }

  /** Leave space for the texts beside the axes. */
  private fit(font: number): void {
    const { context, width, height } = this.drawing;
    const left = context.measureText(texts.shearTick(MOST_UM)).width + GAP;
    this.plot = { left, right: width - GAP, top: font / 2 + 1, bottom: height - font - GAP };
  }

  private drawGrid(): void {
    const { context, colors } = this.drawing;
    const { left, right, top, bottom } = this.plot;
    const shears = SHEARS_UM.map((shear) => [this.y(shear), texts.shearTick(shear)] as const);
    context.beginPath();
    for (const x of FREQUENCIES_HZ.map((f) => this.x(f))) line(context, x, top, x, bottom);
    for (const [y] of shears) line(context, left, y, right, y);
    context.strokeStyle = colors.line;
    context.lineWidth = 1;
    context.stroke();
    context.fillStyle = colors.muted;
    [context.textAlign, context.textBaseline] = ["right", "middle"];
    for (const [y, text] of shears) context.fillText(text, left - GAP, y);
    this.drawFrequencies();
  }

  private drawFrequencies(): void {
    const { context } = this.drawing;
    [context.textAlign, context.textBaseline] = ["left", "top"];
    const drawn: { from: number; to: number }[] = [];
    for (const frequency_hz of FREQUENCIES_HZ) {
      const text = texts.frequencyTick(frequency_hz);
      const { width } = context.measureText(text);
      // not below the numbers of the other axis, and not cut off
      const centered = Math.max(this.x(frequency_hz) - width / 2, this.plot.left);
      const from = Math.min(centered, this.drawing.width - width);
      if (drawn.some((other) => from < other.to + GAP && other.from < from + width + GAP)) continue;
      drawn.push({ from, to: from + width });
      context.fillText(text, from, this.plot.bottom + GAP);
    }
  }

  /** Draw each band as a bar, which is pale below threshold. */
  private drawBars(): void {
    const { context, colors } = this.drawing;
    const { bottom, top } = this.plot;
    context.fillStyle = colors.drive;
    for (const { band, peak_um, level_db } of this.bands) {
      const [from, to] = [this.x(band.from_hz) + BAR_GAP / 2, this.x(band.to_hz) - BAR_GAP / 2];
      const y = Math.max(this.y(peak_um), top);
      context.globalAlpha = level_db > 0 ? FULL : PALE;
      if (y < bottom) context.fillRect(from, y, to - from, bottom - y);
    }
    context.globalAlpha = 1;
  }

  /** Draw a line across each bar, at the top of which it is if what is played is commanded. */
  private drawPlayed(): void {
    const { context, colors } = this.drawing;
    const { bottom, top } = this.plot;
    context.beginPath();
    for (const { band, peak_um } of this.played) {
      const y = Math.max(this.y(peak_um), top);
      if (y < bottom) line(context, this.x(band.from_hz), y, this.x(band.to_hz), y);
    }
    context.strokeStyle = colors.text;
    context.lineWidth = 2;
    context.stroke();
  }

  private drawThreshold(): void {
    const { threshold } = this;
    const { context, colors } = this.drawing;
    const points = [LOWEST_HZ, ...BANDS.map(({ center_hz }) => center_hz), HIGHEST_HZ];
    context.beginPath();
    for (const frequency_hz of points) {
      context.lineTo(this.x(frequency_hz), this.y(threshold.at(frequency_hz)));
    }
    context.setLineDash([6, 4]);
    context.strokeStyle = colors.text;
    context.lineWidth = 2;
    context.stroke();
    context.setLineDash([]);
    const [left, y] = [this.plot.left + GAP, this.y(threshold.at(LOWEST_HZ)) - GAP];
    this.drawName(texts.threshold, left, y, "left");
  }

  /** Draw a name above a point, with a border so that it can be read on bars. */
  private drawName(name: string, x: number, y: number, align: CanvasTextAlign): void {
    const { context, colors } = this.drawing;
    [context.textAlign, context.textBaseline] = [align, "bottom"];
    context.strokeStyle = colors.panel;
    context.lineWidth = 4;
    context.lineJoin = "round";
    context.strokeText(name, x, y);
    context.fillStyle = colors.text;
    context.fillText(name, x, y);
  }

  private x(frequency_hz: number): number {
    const { left, right } = this.plot;
    return left + (right - left) * share(frequency_hz, LOWEST_HZ, HIGHEST_HZ);
  }

  private y(shear_um: number): number {
    const { top, bottom } = this.plot;
    return bottom - (bottom - top) * share(shear_um, LEAST_UM, MOST_UM);
  }
}

/** Return where a value is between two others, on a logarithmic axis. */
function share(value: number, least: number, most: number): number {
  return Math.log(value / least) / Math.log(most / least);
}

function line(context: CanvasRenderingContext2D, x1: number, y1: number, x2: number, y2: number) {
  context.moveTo(x1, y1);
  context.lineTo(x2, y2);
}
