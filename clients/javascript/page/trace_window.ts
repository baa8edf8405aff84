/** The newest samples of a trace, as many as a spectrum needs. */
export class TraceWindow {
  /** Samples, the oldest first; only those since the last gap are of the trace. */
  readonly samples: Float32Array;
  private held = 0;
  private next = NaN;

  constructor(length: number) {
    this.samples = new Float32Array(length);
  }

  /** Whether all samples follow each other without a gap. */
  get isFull(): boolean {
    return this.held === this.samples.length;
  }

  /** Whether nothing moves. */
  get isSilent(): boolean {
    return this.samples.every((sample) => sample === 0);
  }

  /** Add samples, of which the first has a number. */
  take(first: number, samples: Float32Array): void {
    if (first !== this.next) this.held = 0; // samples are missing, or playback began anew
    this.next = first + samples.length;
    const { length } = this.samples;
    const newest = samples.subarray(Math.max(0, samples.length - length));
    this.samples.copyWithin(0, newest.length);
    this.samples.set(newest, length - newest.length);
    this.held = Math.min(this.held + newest.length, length);
  }

  /** Take the next samples for the first ones. */
  clear(): void {
    this.held = 0;
  }
}
