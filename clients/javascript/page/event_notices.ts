import type { EventMessage } from "../client/index.js";
import type { Notice } from "./notice.js";
import type { Session } from "./session.js";
import { texts } from "./texts.js";

/** Show in a sentence what happened without the user's doing. */
export function showEventNotices(session: Session, notice: Notice): void {
  session.failure.on(({ message }) => notice.show(texts.failure(message)));
  session.event.on((event) => {
    const text = sentenceOf(session, event);
    if (text) notice.show(text);
  });
}

function sentenceOf(session: Session, { display, kind, detail = "" }: EventMessage): string {
  const names = session.connection.displays.map(({ name }) => name);
  if (!names.includes(display)) return texts.newDisplay(display);
  if (kind === "fault") return texts.fault(display, detail);
  // Who disarms a display gives no reason. The server gives one where nobody has disarmed it.
  if (kind === "disarmed" && detail) return texts.wasDisarmed(display, detail);
  return "";
}
