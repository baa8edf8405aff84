/** Detection threshold: the peak of a sinusoidal shear that is just felt. */
export class Threshold {
    /** @param pairs Frequencies [Hz] in ascending order, and the threshold there [µm]. */
    constructor(pairs) {
        this.knots = pairs.map(([frequency_hz, um]) => [Math.log(frequency_hz), Math.log(um)]);
    }
    /** Return the threshold [µm] at a frequency: linear in the logarithms, and held at the ends. */
    at(frequency_hz) {
        const x = Math.log(frequency_hz);
        const above = this.knots.findIndex(([knot]) => knot >= x);
        const [x1, y1] = this.knots[above] ?? this.knots[this.knots.length - 1] ?? [0, NaN];
        const [x0, y0] = this.knots[above - 1] ?? [x1, y1];
        return Math.exp(x1 === x0 ? y1 : y0 + ((y1 - y0) * (x - x0)) / (x1 - x0));
    }
}
