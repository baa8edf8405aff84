/** Discrete Fourier transform of a fixed length, a power of two (Cooley and Tukey, radix 2). */
export class FourierTransform {
    constructor(length) {
        this.length = length;
        const bits = Math.log2(length);
        if (!Number.isInteger(bits) || bits < 1)
            throw new RangeError(`${length} is no power of two`);
        const angles = Float64Array.from({ length: length / 2 }, (_, k) => (-2 * Math.PI * k) / length);
        this.cosines = angles.map(Math.cos);
        this.sines = angles.map(Math.sin);
        this.reversed = new Uint32Array(length);
        for (let k = 1; k < length; k++) {
            this.reversed[k] = (this.reversed[k >> 1] >> 1) | ((k & 1) << (bits - 1));
        }
    }
    /** Replace the parts of x by those of its transform X[k] = Σ x[n] exp(−2πi k n / length). */
    transform(real, imaginary) {
        this.permute(real);
        this.permute(imaginary);
        for (let half = 1; half < this.length; half *= 2) {
            for (let k = 0; k < half; k++)
                this.combine(real, imaginary, half, k);
        }
    }
    permute(values) {
        for (let k = 0; k < this.length; k++) {
            const other = this.reversed[k];
            if (other <= k)
                continue;
            const value = values[k];
            values[k] = values[other];
            values[other] = value;
        }
    }
    /** Combine value k of each even with that of each odd transform of length `half`. */
    combine(real, imaginary, half, k) {
        const turn = (k * this.length) / (2 * half);
        const [cosine, sine] = [this.cosines[turn], this.sines[turn]];
        for (let even = k; even < this.length; even += 2 * half) {
            const odd = even + half;
            const [x, y] = [real[odd], imaginary[odd]];
            const [re, im] = [x * cosine - y * sine, x * sine + y * cosine];
            real[odd] = real[even] - re;
            imaginary[odd] = imaginary[even] - im;
            real[even] = real[even] + re;
            imaginary[even] = imaginary[even] + im;
        }
    }
}
