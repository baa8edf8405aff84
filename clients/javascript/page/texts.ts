/** All texts that the page shows, in one place for translation. */

import type { ShownState } from "./session.js";
import { FULL_SCALE_UM } from "./speaker.js";

/** Constant texts, which index.html names in `data-text` and `data-label`. */
export const labels = {
  product: "tactile",
  display: "Display",
  state: "State of the display",
  controls: "High voltage and e-stop",
  arm: "Arm…",
  armConfirm: "Arm",
  cancel: "Cancel",
  disarm: "Disarm",
  estop: "E-stop",
  estopKey: "Esc",
  estopLabel: "E-stop: set all displays to 0 V at once. Key: Escape",
  estopPanel: "An e-stop holds",
  clear: "Clear e-stop…",
  clearConfirm: "Clear e-stop",
  armDialog: "Arm the display",
  clearDialog: "Clear the e-stop",
  close: "Close",
  pad: "Pad",
  padLabel:
    "Pad. Stroke with a mouse, a pen or a finger, or with the arrow keys, faster with Shift. " +
    "Space touches and lifts.",
  padScale:
    "Real size: one CSS pixel is 25.4/96 mm. Keys: arrows stroke, Shift is faster, " +
    "Space touches and lifts.",
  scaleBar: "10 mm",
  array: "Contactors",
  contactor: "One contactor",
  contactorChoice: "Number of the contactor",
  listen: "Listen",
  volume: "Volume",
  fullScale: `At 100 %, ${FULL_SCALE_UM} µm are full scale; peaks beyond are clipped.`,
  textures: "Textures",
  search: "Search textures",
  beside: "Right half",
  gain: "Gain",
  health: "Health",
  moreCounters: "More counters",
  log: "Events",
  token: "Token",
  tokenSend: "Connect",
};

/** Names of the counters of `StatsReply` that a user may want to know. */
const counterNames: Record<string, string> = {
  underruns: "Underruns",
  late_blocks: "Late blocks",
  lost_samples: "Lost samples",
  late_contacts: "Late contacts",
  lost_contacts: "Lost contacts",
  disconnects: "Link losses",
  limited_samples: "Limited samples",
};

const states: Record<ShownState, string> = {
  disarmed: "Disarmed",
  armed: "ARMED",
  estopped: "E-STOP",
  lost: "Lost",
  offline: "Not connected",
};

const provenances: Record<string, string> = {
  fitted: "Fitted to recordings",
  published: "From published measurements",
  authored: "Designed by hand",
};

const eventKinds: Record<string, string> = {
  armed: "armed",
  disarmed: "disarmed",
  estopped: "e-stop",
  cleared: "e-stop cleared",
  fault: "fault",
  underrun: "the drive ran out of samples",
  link: "the link has changed",
  silent: "this page gave no sign of life, and its waveforms were faded out",
  lost: "playback was lost and starts again",
  textures: "the textures were read again",
};

const linkStates: Record<string, string> = { up: "Up", down: "Down" };

/** Texts that change, and sentences with values. */
export const texts = {
  title: (display: string) => (display ? `${display} – tactile` : "tactile"),
  states,
  unknown: "–",
  notConnected: "The server is not connected.",

  // What goes wrong
  unsupported: (missing: string[]) =>
    `This browser is too old for this page: it lacks ${missing.join(", ")}. ` +
    "Use Firefox 98, Chrome 94, Safari 15.4 or a newer version.",
  connecting: (reason: string) =>
    reason ? `There is no connection yet; trying again. ${sentence(reason)}` : "Connecting …",
  connectionLost:
    "The server does not answer; trying again. When it is back, the display is disarmed.",
  refused: (reason: string) => `The server refuses this page. ${sentence(reason)}`,
  closed: (reason: string) =>
    `The connection is closed. ${sentence(reason)} Reload this page to connect again.`,
  noDisplays: "The server has no display. Its configuration needs a [[display]] table.",
  displayIsGone: (display: string) =>
    `The server's configuration does not have the display “${display}” any more. ` +
    "Reload this page to see the displays that there are now.",
  playbackLost: (detail: string) =>
    `Playback was lost and starts again. The display is disarmed then. ${sentence(detail)}`,
  linkDown: (detail: string) =>
    `The link to the display is down; check its cable and its power. ${sentence(detail)}`,
  newDisplay: (display: string) =>
    `The server has a display “${display}” now. Reload this page to see it.`,
  fault: (display: string, detail: string) => `Fault of “${display}”. ${sentence(detail)}`,
  wasDisarmed: (display: string, detail: string) =>
    `“${display}” was disarmed: ${sentence(detail)}`,
  failure: (message: string) => `The server rejected a message of this page: ${sentence(message)}`,

  // High voltage and e-stop
  armQuestion: (display: string, limit_v: number) =>
    `Arming switches on the high voltage of “${display}”: up to ±${limit_v} V next to a finger. ` +
    "Make sure that the person at the display knows.",
  armFailed: (message: string) => `The display was not armed: ${sentence(message)}`,
  disarmFailed: (message: string) =>
    `The display was not disarmed: ${sentence(message)} If in doubt, press the e-stop.`,
  estopUnconfirmed:
    "The e-stop could not be confirmed. It is sent first when the server is back. " +
    "Use the e-stop of the hardware now.",
  estopReason: (number: number, reason: string) =>
    `E-stop ${number || ""} holds the display at 0 V. ${sentence(reason)}`.replace("  ", " "),
  clearHint: "Clear it when a person has checked that it is safe. The display is disarmed then.",
  mayNotClear: "This page may not clear it without a token that has the role “arm”.",
  clearQuestion: (number: number) =>
    `Clear e-stop ${number} only if a person at the display has checked that it is safe. ` +
    "The display is disarmed then.",
  clearFailed: (message: string) => `The e-stop still holds: ${sentence(message)}`,

  // Pad
  padOffline: "Not connected: strokes are not sent.",
  padEstopped: "An e-stop holds: nothing is felt.",
  padLost: "Playback was lost and starts again. Strokes are not sent.",
  padMayNotPlay: "This page may not play without a token that has the role “play”.",
  padSelectAndArm: "Select a texture, arm the display, then stroke here.",
  padDisarmed: "The display is disarmed: nothing is felt. Arm it, then stroke here.",
  padSelect: "Select a texture, then stroke here.",
  fingerOfAnother:
    "Another program has the finger. What you do here counts when that program has lifted it.",
  surfaceScale: (texture: string, lowest_um: number, highest_um: number) =>
    `${texture}: dark ${signed(lowest_um)} µm, light ${signed(highest_um)} µm`,
  noPicture: (message: string) => `The surface could not be drawn: ${sentence(message)}`,
  lifted: "Not touching",
  finger: (x_mm: number, y_mm: number, speed_mm_s: number, force_n: number) =>
    `x ${x_mm.toFixed(1)} mm, y ${y_mm.toFixed(1)} mm · ${speed_mm_s.toFixed(0)} mm/s · ` +
    `${force_n.toFixed(2)} N`,

  // Contactors
  arrayInShort: (shear_um: number | undefined, drive_v: number, limit_v: number) =>
    (shear_um === undefined ? "" : `${shear_um.toFixed(1)} µm · `) +
    `${drive_v.toFixed(0)} V of ${limit_v} V`,
  array: (count: number, shear_um: number | undefined, drive_v: number, limit_v: number) =>
    (shear_um === undefined ? "" : `Largest shear ${shear_um.toFixed(1)} µm. `) +
    `Largest drive ${drive_v.toFixed(0)} V of ${limit_v} V. ` +
    `${count} contactors.`,
  arrayUnknown: "Not known now",
  arrayStill: (limit_v: number) =>
    "The contactors are drawn at rest, because this device asks for little motion. " +
    `Bars: drive up to ${limit_v} V.`,
  arrayScale: (um_per_mm: number | undefined, limit_v: number) =>
    um_per_mm === undefined
      ? `This link does not report shears. The bars show the drive, up to ${limit_v} V.`
      : `${um_per_mm} µm are drawn as 1 mm. Bars: drive up to ${limit_v} V. ` +
        "Lines: range of the shear in the last 0.3 s.",

  // One contactor
  chooseContactor: "Click a contactor to see its spectrum.",
  frequencyTick: (frequency_hz: number) =>
    frequency_hz === 10 ? "10 Hz" : frequency_hz === 1000 ? "1 kHz" : String(frequency_hz),
  shearTick: (shear_um: number) => (shear_um === 100 ? "100 µm" : String(shear_um)),
  threshold: "Detection threshold",
  bars: "Peak per third octave",
  barsAndPlayed: "Bars: commanded. Lines: on the skin",
  strongest: (level_db: number, frequency_hz: number) =>
    `Strongest: ${level_db.toFixed(0)} dB above threshold at ${frequency_hz} Hz`,
  onSkin: (level_db: number) => `, ${level_db.toFixed(0)} dB on the skin`,
  belowThreshold: "Below threshold everywhere",
  nothingPlays: "Nothing plays",
  noTrace: "This link takes spectra: there are no samples to show, or to listen to.",
  spectrum: (contactor: number, [x_mm, y_mm]: readonly [number, number], summary: string) =>
    `Shear of contactor ${contactor} at x ${x_mm.toFixed(1)} mm, ` +
    `y ${y_mm.toFixed(1)} mm in third octaves from 10 Hz to 1 kHz, and the detection threshold. ${sentence(summary)}`,
  listenFailed: (message: string) => `The loudspeaker cannot be used: ${sentence(message)}`,

  // Textures and gain
  provenance: (provenance: string) => entry(provenances, provenance) ?? `Parameters: ${provenance}`,
  noTextureMatches: (search: string) => `No texture matches “${search}”.`,
  noTextures: (message: string) =>
    `The list of textures could not be read: ${sentence(message)} Reload this page to try again.`,
  nothingSelected: "No texture is selected.",
  selected: (left: string, right: string) =>
    right ? `Left: ${left}. Right: ${right}` : `Selected: ${left}`,
  sameBeside: "The same texture",
  preparing: (name: string) => `Preparing ${name} …`,
  selectFailed: (name: string, message: string) =>
    `“${name}” cannot be played: ${sentence(message)} Select it again, or another texture.`,
  percent: (percent: number) => `${percent} %`,
  gainFailed: (message: string) => `The gain was not changed: ${sentence(message)}`,

  // Health
  link: "Link",
  linkState: (state: string) => entry(linkStates, state) ?? state,
  latency: "Latency to skin",
  lead: "Lead of the link",
  roundTrip: "Round trip",
  putOut: "Samples",
  fingerLabel: "Finger",
  nobodyTouches: "Not touching",
  thisPageTouches: "This page",
  anotherTouches: "Another program",
  milliseconds: (value: number | undefined) =>
    value === undefined ? "–" : `${value.toFixed(value < 10 ? 1 : 0)} ms`,
  share: (share: number | null | undefined) =>
    share === null || share === undefined ? "–" : `${(100 * share).toFixed(1)} % put out`,
  counter: (name: string) => entry(counterNames, name) ?? name.replace(/_/g, " "),
  count: (value: number) => value.toLocaleString("en"),

  // Token
  tokenWanted:
    "The server wants a token. It is in the file that token_file or a [[token]] table of the " +
    "server's configuration names; whoever set up the server has it. This page forgets it when " +
    "it is closed.",
  tokenForRoles:
    "Tokens are in the server's configuration; this page forgets its token when it is closed.",
  roles: (roles: readonly string[], lacking: readonly string[]) =>
    `Roles of this page: ${roles.join(", ") || "none"}. It may not ${lacking.join(" and not ")} ` +
    "without a token that has this role; it may always e-stop.",

  // Events
  connectionStates: {
    connecting: "The server does not answer",
    connected: "Connected to the server",
    refused: "Refused by the server",
    closed: "Connection closed",
  },
  event: (display: string, kind: string, detail: string) =>
    `${display}: ${entry(eventKinds, kind) ?? kind}${detail ? ` (${detail})` : ""}`,
};

/** Return the entry of a name that a server sent, which may be that of something every object has. */
function entry(table: Record<string, string>, name: string): string | undefined {
  return Object.prototype.hasOwnProperty.call(table, name) ? table[name] : undefined;
}

/** Return a number with one decimal and, below zero, with a minus sign instead of a hyphen. */
function signed(value: number): string {
  return value.toFixed(1).replace("-", "−");
}

/** Return a text of the server as a sentence: with a capital letter and a full stop. */
function sentence(text: string): string {
  if (!text) return "";
  const capital = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(capital) ? capital : `${capital}.`;
}
