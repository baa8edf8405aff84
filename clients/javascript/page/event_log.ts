import { byId, element } from "./dom.js";
import type { Session } from "./session.js";
import { texts } from "./texts.js";

const MOST_ENTRIES = 20;

/** Keep a log of the last events and failures, the newest first. */
export function showEventLog(session: Session): void {
  const log = byId("log");
  const add = (text: string) => {
    const entry = element("p");
    entry.append(element("time", new Date().toLocaleTimeString()), element("span", text));
    log.prepend(entry);
    while (log.childElementCount > MOST_ENTRIES) log.lastElementChild?.remove();
  };
  let connection = "";
  session.changed.on(() => {
    const { state } = session.connection;
    const isFirstAttempt = state === "connecting" && !session.hasFailed;
    if (state !== connection && !isFirstAttempt) add(texts.connectionStates[state]);
    connection = state;
  });
  session.event.on(({ display, kind, detail }) => add(texts.event(display, kind, detail ?? "")));
  session.failure.on(({ message }) => add(texts.failure(message)));
}
