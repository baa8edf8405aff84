/** Carries out requests one after the other, of which only the newest value matters. */
export class Newest<T> {
  private waiting: { value: T } | undefined;
  private busy = false;

  /**
   * @param request Sends one value.
   * @param settled Called after each request with its value, and its error if there was one,
   *   unless a newer value waits.
   */
  constructor(
    private readonly request: (value: T) => Promise<void>,
    private readonly settled: (value: T, error?: Error) => void,
  ) {}

  /** Send a value as soon as the request before it is done, unless a newer one replaces it. */
  send(value: T): void {
    this.waiting = { value };
    if (!this.busy) void this.sendAll();
  }

  private async sendAll(): Promise<void> {
    this.busy = true;
    while (this.waiting !== undefined) {
      const { value } = this.waiting;
      this.waiting = undefined;
      const error = await this.request(value).then(() => undefined, (reason: Error) => reason);
      if (this.waiting === undefined) this.settled(value, error);
    }
    this.busy = false;
  }
}
