/** Where a chunk of samples is played. */
export interface Place {
  /** Sample of the player's clock with which the chunk begins. */
  readonly begin: number;
  /** Whether it does not go on from the chunk before, so that both must be faded. */
  readonly begins: boolean;
}

/** Limits of what waits to be played [samples]. */
export interface QueueLimits {
  /** Delay with which playing begins. */
  readonly target: number;
  /** Delay beyond which chunks are skipped until it is down to the target. */
  readonly most: number;
  /** Delay below which it is too late to go on without a gap. */
  readonly least: number;
}

/** Decides when chunks of samples, which come about as fast as they are played, are played. */
export class Schedule {
  /** Number of times at which one chunk did not go on from the one before. */
  gaps = 0;
  private end = -Infinity;
  private skips = false;

  constructor(private readonly limits: QueueLimits) {}

  /**
   * Place the next chunk.
   *
   * @param now Sample that is being played.
   * @param length Number of samples of the chunk.
   * @param follows Whether it follows the chunk before without missing samples.
   * @returns Its place; undefined if it is to be skipped.
   */
  place(now: number, length: number, follows: boolean): Place | undefined {
    const { target, most, least } = this.limits;
    const isDry = this.end - now < least;
    const begin = isDry ? now + target : this.end;
    const begins = isDry || !follows || this.skips;
    this.skips = begin + length > now + most || (this.skips && begin > now + target);
    if (this.skips) return undefined;
    if (begins && this.end > -Infinity) this.gaps++;
    this.end = begin + length;
    return { begin, begins };
  }
}
