import { LineSpectrum } from "./line_spectrum.js";
import { BANDS, bandPower } from "./third_octaves.js";
import type { Band } from "./third_octaves.js";
import type { Threshold } from "./threshold.js";
import { TraceWindow } from "./trace_window.js";

/** Longest time of which a spectrum is computed [s]; the power of two below it is taken. */
const LONGEST_S = 0.55;
/** Time in which what was there before falls to 1/e [s]. */
const SMOOTHING_S = 0.25;
/** Number of samples of which a spectrum is computed at most, whatever the sample rate. */
const MOST_SAMPLES = 2 ** 16;
/** Largest shear that is taken [µm]: one that is beyond all displays would be seen for minutes. */
const MOST_UM = 1000;

/** Shear of a third octave. */
export interface BandShear {
  readonly band: Band;
  /**
   * Peak of the sinusoid that has the power of the band, √2 times its rms [µm], because thresholds
   * are peaks of sinusoids.
   */
  readonly peak_um: number;
  /**
   * Sensation level [dB SL], as `band_sensation` in tactile/texture/perception.py computes it: the
   * power of each line is divided by that of a sinusoid at the threshold of its own frequency.
   */
  readonly level_db: number;
}

/**
 * Spectrum of the commanded shear of a contactor in third octaves, smoothed over time.
 *
 * With 8 kHz it is that of 0.51 s, whose Hann window gives a sinusoid a width of ±3.9 Hz. Bands
 * below 30 Hz are narrower than that, so that there a sinusoid is also seen in the neighbors.
 */
export class ContactorSpectrum {
  /** Third octaves below half the sample rate; empty while nothing plays. */
  bands: readonly BandShear[] = [];
  private readonly window: TraceWindow;
  private readonly spectrum: LineSpectrum;
  private readonly resolution_hz: number;
  private readonly range: readonly Band[];
  private lines: Float64Array | undefined;

  constructor(sample_rate_hz: number, private readonly threshold: Threshold) {
    const wanted = Math.min(Math.max(LONGEST_S * sample_rate_hz, 2), MOST_SAMPLES);
    const length = 2 ** Math.floor(Math.log2(wanted));
    this.window = new TraceWindow(length);
    this.spectrum = new LineSpectrum(length);
    this.resolution_hz = sample_rate_hz / length;
    this.range = BANDS.filter(({ to_hz }) => to_hz <= sample_rate_hz / 2);
  }

  /** Band with the highest sensation level; undefined while nothing plays. */
  get strongest(): BandShear | undefined {
    return [...this.bands].sort((one, other) => other.level_db - one.level_db)[0];
  }

  /** Take samples [µm], of which the first has a number. */
  take(first: number, shear_um: Float32Array): void {
    this.window.take(first, shear_um.map(usable));
  }

  /**
   * Compute the spectrum of the newest samples, and smooth it.
   *
   * @param passed_s Time since the last update [s].
   */
  update(passed_s: number): void {
    if (!this.window.isFull) return;
    if (this.window.isSilent) return this.forget();
    const lines = this.spectrum.powers(this.window.samples);
    const { lines: before } = this;
    const kept = Math.exp(-passed_s / SMOOTHING_S);
    this.lines = before ? lines.map((p, k) => p + kept * ((before[k] as number) - p)) : lines;
    this.bands = this.range.map((band) => this.shear(band, this.lines as Float64Array));
  }

  /** Begin anew, as nothing plays any more. */
  clear(): void {
    this.window.clear();
    this.forget();
  }

  private forget(): void {
    this.lines = undefined;
    this.bands = [];
  }

  private shear(band: Band, lines: Float64Array): BandShear {
    const weight = (frequency_hz: number) => this.threshold.at(frequency_hz) ** -2;
    const power = bandPower(lines, this.resolution_hz, band);
    const relative = bandPower(lines, this.resolution_hz, band, weight);
    return { band, peak_um: Math.sqrt(2 * power), level_db: 10 * Math.log10(2 * relative) };
  }
}

/** Return a shear [µm] within limits, and 0 for what is no number: it would stay in the spectrum. */
function usable(shear_um: number): number {
  return Math.min(Math.max(shear_um, -MOST_UM), MOST_UM) || 0;
}
