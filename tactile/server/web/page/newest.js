/** Carries out requests one after the other, of which only the newest value matters. */
export class Newest {
    /**
     * @param request Sends one value.
     * @param settled Called after each request with its value, and its error if there was one,
     *   unless a newer value waits.
     */
    constructor(request, settled) {
        this.request = request;
        this.settled = settled;
        this.busy = false;
    }
    /** Send a value as soon as the request before it is done, unless a newer one replaces it. */
    send(value) {
        this.waiting = { value };
        if (!this.busy)
            void this.sendAll();
    }
    async sendAll() {
        this.busy = true;
        while (this.waiting !== undefined) {
            const { value } = this.waiting;
            this.waiting = undefined;
            const error = await this.request(value).then(() => undefined, (reason) => reason);
            if (this.waiting === undefined)
                this.settled(value, error);
        }
        this.busy = false;
    }
}
