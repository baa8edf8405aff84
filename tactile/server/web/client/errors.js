/** Errors of the client: what a promise is rejected with. */
/** Base class of all errors of this client. */
export class ClientError extends Error {
    constructor(message) {
        super(message);
        this.name = new.target.name;
    }
}
/** The server is not there, or went away before it answered. */
export class DisconnectedError extends ClientError {
}
/** The server could not carry out a request, and said why. */
export class RequestError extends ClientError {
    constructor(failure) {
        super(failure.field ? `${failure.field}: ${failure.message}` : failure.message);
        this.failure = failure;
        this.code = failure.code;
        this.field = failure.field ?? "";
    }
}
