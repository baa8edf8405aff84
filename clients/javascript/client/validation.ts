/** Checks of what a server sends: a program gets no message that lacks what it must have. */

import type { Answer } from "./messages.js";
import { ANSWERS, SHAPES } from "./shapes.js";
import type { Kind, Shape } from "./shapes.js";

/** A map with a text that names its type. */
export interface Typed {
  readonly type: string;
  readonly [field: string]: unknown;
}

/** Return whether a value is a message, of whatever type. */
export function isTyped(value: unknown): value is Typed {
  return isMap(value) && typeof value.type === "string";
}

/** Return whether the API has a message of the server of a type. */
export function isKnown(type: string): type is Answer["type"] {
  return Object.prototype.hasOwnProperty.call(ANSWERS, type);
}

/**
 * Return what keeps a message from being one of the API, such as "drive_v is no list"; empty if
 * nothing does. Fields that are not known are ignored: a later server may have more.
 */
export function faultOf(message: Typed): string {
  if (!isKnown(message.type)) return "its type is not known";
  return faultIn(message, { shape: ANSWERS[message.type] as string }).replace(/^\./, "");
}

function isMap(value: unknown): value is Record<string, unknown> {
  const isObject = typeof value === "object" && value !== null;
  return isObject && !Array.isArray(value) && !(value instanceof Uint8Array);
}

/** Return what keeps a value from being of a kind, with the path to it; empty if nothing does. */
function faultIn(value: unknown, kind: Kind): string {
  if (typeof kind === "string") return isScalar(value, kind) ? "" : ` is no ${kind}`;
  if ("anyOf" in kind) {
    const faults = kind.anyOf.map((one) => faultIn(value, one));
    return faults.includes("") ? "" : (faults[0] as string);
  }
  if ("list" in kind) {
    if (!Array.isArray(value)) return " is no list";
    return faultInItems(value, () => kind.list);
  }
  if ("tuple" in kind) {
    const { length } = kind.tuple;
    if (!Array.isArray(value) || value.length !== length) return ` is no list of ${length}`;
    return faultInItems(value, (k) => kind.tuple[k] as Kind);
  }
  if (!isMap(value)) return " is no map";
  if ("map" in kind) return faultInItems(Object.values(value), () => kind.map);
  return faultInFields(value, SHAPES[kind.shape] as Shape);
}

function faultInItems(items: readonly unknown[], kindAt: (k: number) => Kind): string {
  for (let k = 0; k < items.length; k++) {
    const fault = faultIn(items[k], kindAt(k));
    if (fault) return `[${k}]${fault}`;
  }
  return "";
}

function faultInFields(value: Record<string, unknown>, { required, optional }: Shape): string {
  for (const [name, kind] of Object.entries({ ...required, ...optional })) {
    if (name in optional && value[name] === undefined) continue;
    const fault = faultIn(value[name], kind);
    if (fault) return `.${name}${fault}`;
  }
  return "";
}

/** Numbers that are not finite are none: JSON has none of them either. */
function isScalar(value: unknown, kind: Extract<Kind, string>): boolean {
  switch (kind) {
    case "null": return value === null;
    case "bytes": return value instanceof Uint8Array;
    case "integer": return Number.isInteger(value);
    case "number": return Number.isFinite(value);
    case "string": return typeof value === "string";
    case "boolean": return typeof value === "boolean";
  }
}
