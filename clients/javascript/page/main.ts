/** The page of the server: starts each part of it. */

import { Arming } from "./arming.js";
import { ArrayView } from "./array_view.js";
import { showConnectionBanner } from "./connection_banner.js";
import { ContactorChoice } from "./contactor_choice.js";
import { ContactorPanel } from "./contactor_panel.js";
import { showDisplayHeader } from "./display_header.js";
import { byId, writeConstantTexts } from "./dom.js";
import { EStopControl } from "./estop.js";
import { showEventLog } from "./event_log.js";
import { showEventNotices } from "./event_notices.js";
import { Finger } from "./finger.js";
import { handleGain } from "./gain.js";
import { showHealth } from "./health.js";
import { Notice } from "./notice.js";
import { showPadHint } from "./pad_hint.js";
import { PadKeys } from "./pad_keys.js";
import { strokeByPointer } from "./pad_pointer.js";
import { PadSurface } from "./pad_surface.js";
import { PadView } from "./pad_view.js";
import { Selection } from "./selection.js";
import { Session } from "./session.js";
import { texts } from "./texts.js";
import { TexturePicker } from "./texture_picker.js";
import { handleToken } from "./token_form.js";

/** What the page needs of the browser, by the names of the global objects. */
const NEEDED = ["WebSocket", "PointerEvent", "ResizeObserver", "HTMLDialogElement"];

function start(): void {
  const session = new Session();
  const notice = new Notice();
  new EStopControl(session, notice); // first, so that it works whatever happens after it
  new Arming(session, notice);
  showDisplayHeader(session);
  showConnectionBanner(session);
  handleToken(session);
  handleGain(session);
  showHealth(session);
  showEventLog(session);
  showEventNotices(session, notice);
  const selection = new Selection(session);
  new TexturePicker(session, selection);
  chooseNamedTexture(session, selection);
  const pad = byId<HTMLCanvasElement>("pad");
  const finger = new Finger(session);
  strokeByPointer(pad, finger);
  new PadKeys(pad, finger);
  const surface = new PadSurface(byId<HTMLCanvasElement>("pad-surface"), session, selection);
  finger.changed.on(({ touching }) => session.hurry("stroke", touching));
  finger.moved.on(({ x_mm }) => selection.enter(surface.half(x_mm)));
  new PadView(pad, finger);
  showPadHint(session, finger, selection);
  const choice = new ContactorChoice(session);
  new ArrayView(byId<HTMLCanvasElement>("array"), session, choice);
  new ContactorPanel(session, choice);
}

/** Choose the texture that the address names, as in "#texture=wood-oak", once there is a display. */
function chooseNamedTexture(session: Session, selection: Selection): void {
  let name = new URLSearchParams(location.hash.slice(1)).get("texture");
  session.changed.on(() => {
    if (!name || !session.display || !session.may("play")) return;
    selection.choose(name);
    name = null;
  });
}

const missing = NEEDED.filter((name) => !(name in window));
if (missing.length > 0) {
  byId("unsupported").textContent = texts.unsupported(missing);
} else {
  byId("loading").remove();
  byId("unsupported").remove();
  writeConstantTexts();
  byId("page").hidden = false;
  start();
}
