/** Discrete Fourier transform of a fixed length, a power of two (Cooley and Tukey, radix 2). */
export class FourierTransform {
  /** Real and imaginary part of exp(−2πi k / length) for the first half of k. */
  private readonly cosines: Float64Array;
  private readonly sines: Float64Array;
  /** Where each value belongs before the first step: its index with the bits reversed. */
  private readonly reversed: Uint32Array;

  constructor(readonly length: number) {
    const bits = Math.log2(length);
    if (!Number.isInteger(bits) || bits < 1) throw new RangeError(`${length} is no power of two`);
    const angles = Float64Array.from({ length: length / 2 }, (_, k) => (-2 * Math.PI * k) / length);
    this.cosines = angles.map(Math.cos);
    this.sines = angles.map(Math.sin);
    this.reversed = new Uint32Array(length);
    for (let k = 1; k < length; k++) {
      this.reversed[k] = ((this.reversed[k >> 1] as number) >> 1) | ((k & 1) << (bits - 1));
    }
  }

  /** Replace the parts of x by those of its transform X[k] = Σ x[n] exp(−2πi k n / length). */
  transform(real: Float64Array, imaginary: Float64Array): void {
    this.permute(real);
    this.permute(imaginary);
    for (let half = 1; half < this.length; half *= 2) {
      for (let k = 0; k < half; k++) this.combine(real, imaginary, half, k);
    }
  }

  private permute(values: Float64Array): void {
    for (let k = 0; k < this.length; k++) {
      const other = this.reversed[k] as number;
      if (other <= k) continue;
      const value = values[k] as number;
      values[k] = values[other] as number;
      values[other] = value;
    }
  }

  /** Combine value k of each even with that of each odd transform of length `half`. */
  private combine(real: Float64Array, imaginary: Float64Array, half: number, k: number): void {
    const turn = (k * this.length) / (2 * half);
    const [cosine, sine] = [this.cosines[turn] as number, this.sines[turn] as number];
    for (let even = k; even < this.length; even += 2 * half) {
      const odd = even + half;
      const [x, y] = [real[odd] as number, imaginary[odd] as number];
      const [re, im] = [x * cosine - y * sine, x * sine + y * cosine];
      real[odd] = (real[even] as number) - re;
      imaginary[odd] = (imaginary[even] as number) - im;
      real[even] = (real[even] as number) + re;
      imaginary[even] = (imaginary[even] as number) + im;
    }
  }
}
