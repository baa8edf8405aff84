/** Client of the tactile server, for browsers and node. */
export * from "./connection.js";
export * from "./display.js";
export * from "./errors.js";
export * from "./messages.js";
