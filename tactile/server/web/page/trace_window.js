/** The newest samples of a trace, as many as a spectrum needs. */
export class TraceWindow {
    constructor(length) {
        this.held = 0;
        this.next = NaN;
        this.samples = new Float32Array(length);
    }
    /** Whether all samples follow each other without a gap. */
    get isFull() {
        return this.held === this.samples.length;
    }
    /** Whether nothing moves. */
    get isSilent() {
        return this.samples.every((sample) => sample === 0);
    }
    /** Add samples, of which the first has a number. */
    take(first, samples) {
        if (first !== this.next)
            this.held = 0; // samples are missing, or playback began anew
        this.next = first + samples.length;
        const { length } = this.samples;
        const newest = samples.subarray(Math.max(0, samples.length - length));
        this.samples.copyWithin(0, newest.length);
        this.samples.set(newest, length - newest.length);
        this.held = Math.min(this.held + newest.length, length);
    }
    /** Take the next samples for the first ones. */
    clear() {
        this.held = 0;
    }
}
