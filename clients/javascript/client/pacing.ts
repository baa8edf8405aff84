/** Limit on how many messages a client sends, below the rate at which the server drops them. */

/** Share of the server's messages per second that streams may use; the rest is for requests. */
const SHARE_OF_STREAMS = 0.9;
/** Time whose messages may go out at once [s]: browsers hand pointer events over in batches. */
const BURST_S = 0.1;

/** Token bucket for contacts and tactile frames. */
export class StreamPacing {
  private readonly rate_hz: number;
  private tokens: number;
  private time_us = 0;

  /** @param messagesPerSecond What the server accepts of this client; 0 if it has no limit. */
  constructor(messagesPerSecond: number) {
    this.rate_hz = messagesPerSecond > 0 ? SHARE_OF_STREAMS * messagesPerSecond : Infinity;
    this.tokens = this.rate_hz * BURST_S;
  }

  /** Return whether one more message may be sent at a time [µs]. */
  take(time_us: number): boolean {
    if (this.rate_hz === Infinity) return true;
    const refilled = this.tokens + (time_us - this.time_us) * 1e-6 * this.rate_hz;
    this.tokens = Math.min(this.rate_hz * BURST_S, refilled);
    this.time_us = time_us;
    if (this.tokens < 1) return false;
    this.tokens -= 1;
    return true;
  }
}
