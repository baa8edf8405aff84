/** Decides when chunks of samples, which come about as fast as they are played, are played. */
export class Schedule {
    constructor(limits) {
        this.limits = limits;
        /** Number of times at which one chunk did not go on from the one before. */
        this.gaps = 0;
        this.end = -Infinity;
        this.skips = false;
    }
    /**
     * Place the next chunk.
     *
     * @param now Sample that is being played.
     * @param length Number of samples of the chunk.
     * @param follows Whether it follows the chunk before without missing samples.
     * @returns Its place; undefined if it is to be skipped.
     */
    place(now, length, follows) {
        const { target, most, least } = this.limits;
        const isDry = this.end - now < least;
        const begin = isDry ? now + target : this.end;
        const begins = isDry || !follows || this.skips;
        this.skips = begin + length > now + most || (this.skips && begin > now + target);
        if (this.skips)
            return undefined;
        if (begins && this.end > -Infinity)
            this.gaps++;
        this.end = begin + length;
        return { begin, begins };
    }
}
