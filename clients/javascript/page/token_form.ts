import { byId, setText } from "./dom.js";
import type { Session } from "./session.js";
import { texts } from "./texts.js";

/** Roles without which a part of this page does not work. */
const NEEDED = ["play", "arm"] as const;

/** Ask for a token if the server wants one, or if this page may not do everything. */
export function handleToken(session: Session): void {
  const box = byId("token-box");
  const token = byId<HTMLInputElement>("token");
  byId("token-form").addEventListener("submit", (event) => {
    event.preventDefault();
    // Kept by the connection only: neither stored nor in the address, where others could find it.
    session.open(token.value.trim());
    token.value = "";
  });
  session.changed.on(() => {
    const isRefused = session.connection.state === "refused";
    const lacking = session.isConnected ? NEEDED.filter((role) => !session.may(role)) : [];
    box.hidden = !isRefused && lacking.length === 0;
    const roles = session.connection.welcome?.roles ?? [];
    setText(byId("roles"), lacking.length ? texts.roles(roles, lacking) : "");
    setText(byId("token-why"), isRefused ? texts.tokenWanted : texts.tokenForRoles);
  });
}
