import { FourierTransform } from "./fft.js";

/** Computes spectra of the same number of samples, with a Hann window. */
export class LineSpectrum {
  private readonly transform: FourierTransform;
  private readonly window: Float64Array;
  private readonly real: Float64Array;
  private readonly imaginary: Float64Array;

  /** @param length Number of samples, a power of two. */
  constructor(readonly length: number) {
    this.transform = new FourierTransform(length);
    this.window = new Float64Array(length).map((_, n) => Math.sin((Math.PI * n) / length) ** 2);
    this.real = new Float64Array(length);
    this.imaginary = new Float64Array(length);
  }

  /**
   * Compute the mean square of the samples that each line stands for. Line k is at k times the
   * sample rate divided by the length.
   *
   * The lines of a sinusoid with the peak A add up to A²/2, for those of a window with the squares
   * w² are 2 |X|² / (length · Σ w²), and Σ w² = 3/8 length (Parseval's theorem).
   *
   * @returns Lines from 0 up to, but without, half the sample rate, in the square of the unit of
   *   the samples. The one at 0 is twice too large; no third octave contains it.
   */
  powers(samples: Float32Array): Float64Array {
    const { length, real, imaginary } = this;
    for (let n = 0; n < length; n++) real[n] = (samples[n] ?? 0) * (this.window[n] as number);
    imaginary.fill(0);
    this.transform.transform(real, imaginary);
    const scale = 2 / (length * (3 / 8) * length);
    return real
      .subarray(0, length / 2)
      .map((re, k) => scale * (re * re + (imaginary[k] as number) ** 2));
  }
}
