import { LineSpectrum } from "./line_spectrum.js";
import { BANDS, bandPower } from "./third_octaves.js";
import { TraceWindow } from "./trace_window.js";
/** Longest time of which a spectrum is computed [s]; the power of two below it is taken. */
const LONGEST_S = 0.55;
/** Time in which what was there before falls to 1/e [s]. */
const SMOOTHING_S = 0.25;
/** Number of samples of which a spectrum is computed at most, whatever the sample rate. */
const MOST_SAMPLES = 2 ** 16;
/** Largest shear that is taken [µm]: one that is beyond all displays would be seen for minutes. */
const MOST_UM = 1000;
/**
 * Spectrum of the commanded shear of a contactor in third octaves, smoothed over time.
 *
 * With 8 kHz it is that of 0.51 s, whose Hann window gives a sinusoid a width of ±3.9 Hz. Bands
 * below 30 Hz are narrower than that, so that there a sinusoid is also seen in the neighbors.
 */
export class ContactorSpectrum {
    constructor(sample_rate_hz, threshold) {
        this.threshold = threshold;
        /** Third octaves below half the sample rate; empty while nothing plays. */
        this.bands = [];
        const wanted = Math.min(Math.max(LONGEST_S * sample_rate_hz, 2), MOST_SAMPLES);
        const length = 2 ** Math.floor(Math.log2(wanted));
        this.window = new TraceWindow(length);
        this.spectrum = new LineSpectrum(length);
        this.resolution_hz = sample_rate_hz / length;
        this.range = BANDS.filter(({ to_hz }) => to_hz <= sample_rate_hz / 2);
    }
    /** Band with the highest sensation level; undefined while nothing plays. */
    get strongest() {
        return [...this.bands].sort((one, other) => other.level_db - one.level_db)[0];
    }
    /** Take samples [µm], of which the first has a number. */
    take(first, shear_um) {
        this.window.take(first, shear_um.map(usable));
    }
    /**
     * Compute the spectrum of the newest samples, and smooth it.
     *
     * @param passed_s Time since the last update [s].
     */
    update(passed_s) {
        if (!this.window.isFull)
            return;
        if (this.window.isSilent)
            return this.forget();
        const lines = this.spectrum.powers(this.window.samples);
        const { lines: before } = this;
        const kept = Math.exp(-passed_s / SMOOTHING_S);
        this.lines = before ? lines.map((p, k) => p + kept * (before[k] - p)) : lines;
        this.bands = this.range.map((band) => this.shear(band, this.lines));
    }
    /** Begin anew, as nothing plays any more. */
    clear() {
        this.window.clear();
        this.forget();
    }
    forget() {
        this.lines = undefined;
        this.bands = [];
    }
    shear(band, lines) {
        const weight = (frequency_hz) => this.threshold.at(frequency_hz) ** -2;
        const power = bandPower(lines, this.resolution_hz, band);
        const relative = bandPower(lines, this.resolution_hz, band, weight);
        return { band, peak_um: Math.sqrt(2 * power), level_db: 10 * Math.log10(2 * relative) };
    }
}
/** Return a shear [µm] within limits, and 0 for what is no number: it would stay in the spectrum. */
function usable(shear_um) {
    return Math.min(Math.max(shear_um, -MOST_UM), MOST_UM) || 0;
}
