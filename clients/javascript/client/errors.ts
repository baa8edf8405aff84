/** Errors of the client: what a promise is rejected with. */

import type { Failure } from "./messages.js";

/** Base class of all errors of this client. */
export class ClientError extends Error {
  constructor(message: string) {
    super(message);
    this.name = new.target.name;
  }
}

/** The server is not there, or went away before it answered. */
export class DisconnectedError extends ClientError {}

/** The server could not carry out a request, and said why. */
export class RequestError extends ClientError {
  /** Kind of the failure, such as "not_armed". */
  readonly code: Failure["code"];
  /** Path of the field of the message that is to blame; empty if none is. */
  readonly field: string;

  constructor(readonly failure: Failure) {
    super(failure.field ? `${failure.field}: ${failure.message}` : failure.message);
    this.code = failure.code;
    this.field = failure.field ?? "";
  }
}
