/** The clock of this program, and how far the server's is from it. */
/** Number of exchanges among which the quickest gives the offset. */
const EXCHANGES = 8;
/** Return the present time of this program's monotonic clock, that of `event.timeStamp` [µs]. */
export function now_us() {
    return Math.round(performance.now() * 1000);
}
/** Offset between two clocks, from the quickest of the last exchanges, which is the best. */
export class ClockOffset {
    constructor() {
        this.exchanges = [];
    }
    /**
     * Take one exchange.
     *
     * @param sent_us Time of the question on our clock [µs].
     * @param theirs_us Time of the answer on their clock [µs].
     * @param received_us Time at which the answer came on our clock [µs].
     */
    add(sent_us, theirs_us, received_us) {
        const exchange = {
            roundTrip_us: received_us - sent_us,
            offset_us: theirs_us - (sent_us + received_us) / 2,
        };
        this.exchanges = [...this.exchanges, exchange].slice(-EXCHANGES);
    }
    /** Duration of the quickest exchange [µs]; undefined before the first. */
    get roundTrip_us() {
        return this.best?.roundTrip_us;
    }
    /** Their clock less ours [µs]; undefined before the first exchange. */
    get offset_us() {
        return this.best?.offset_us;
    }
    get best() {
        const byRoundTrip = [...this.exchanges].sort((a, b) => a.roundTrip_us - b.roundTrip_us);
        return byRoundTrip[0];
    }
}
