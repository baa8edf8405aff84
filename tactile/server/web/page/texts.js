/** All texts that the page shows, in one place for translation. */
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
    padLabel: "Pad. Stroke with a mouse, a pen or a finger, or with the arrow keys, faster with Shift. " +
        "Space touches and lifts.",
    padScale: "Real size: one CSS pixel is 25.4/96 mm. Keys: arrows stroke, Shift is faster, " +
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
const counterNames = {
    underruns: "Underruns",
    late_blocks: "Late blocks",
    lost_samples: "Lost samples",
    late_contacts: "Late contacts",
    lost_contacts: "Lost contacts",
    disconnects: "Link losses",
    limited_samples: "Limited samples",
};
const states = {
    disarmed: "Disarmed",
    armed: "ARMED",
    estopped: "E-STOP",
    lost: "Lost",
    offline: "Not connected",
};
const provenances = {
    fitted: "Fitted to recordings",
    published: "From published measurements",
    authored: "Designed by hand",
};
const eventKinds = {
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
const linkStates = { up: "Up", down: "Down" };
/** Texts that change, and sentences with values. */
export const texts = {
    title: (display) => (display ? `${display} – tactile` : "tactile"),
    states,
    unknown: "–",
    notConnected: "The server is not connected.",
    // What goes wrong
    unsupported: (missing) => `This browser is too old for this page: it lacks ${missing.join(", ")}. ` +
        "Use Firefox 98, Chrome 94, Safari 15.4 or a newer version.",
    connecting: (reason) => reason ? `There is no connection yet; trying again. ${sentence(reason)}` : "Connecting …",
    connectionLost: "The server does not answer; trying again. When it is back, the display is disarmed.",
    refused: (reason) => `The server refuses this page. ${sentence(reason)}`,
    closed: (reason) => `The connection is closed. ${sentence(reason)} Reload this page to connect again.`,
    noDisplays: "The server has no display. Its configuration needs a [[display]] table.",
    displayIsGone: (display) => `The server's configuration does not have the display “${display}” any more. ` +
        "Reload this page to see the displays that there are now.",
    playbackLost: (detail) => `Playback was lost and starts again. The display is disarmed then. ${sentence(detail)}`,
    linkDown: (detail) => `The link to the display is down; check its cable and its power. ${sentence(detail)}`,
    newDisplay: (display) => `The server has a display “${display}” now. Reload this page to see it.`,
    fault: (display, detail) => `Fault of “${display}”. ${sentence(detail)}`,
    wasDisarmed: (display, detail) => `“${display}” was disarmed: ${sentence(detail)}`,
    failure: (message) => `The server rejected a message of this page: ${sentence(message)}`,
    // High voltage and e-stop
    armQuestion: (display, limit_v) => `Arming switches on the high voltage of “${display}”: up to ±${limit_v} V next to a finger. ` +
        "Make sure that the person at the display knows.",
    armFailed: (message) => `The display was not armed: ${sentence(message)}`,
    disarmFailed: (message) => `The display was not disarmed: ${sentence(message)} If in doubt, press the e-stop.`,
    estopUnconfirmed: "The e-stop could not be confirmed. It is sent first when the server is back. " +
        "Use the e-stop of the hardware now.",
    estopReason: (number, reason) => `E-stop ${number || ""} holds the display at 0 V. ${sentence(reason)}`.replace("  ", " "),
    clearHint: "Clear it when a person has checked that it is safe. The display is disarmed then.",
    mayNotClear: "This page may not clear it without a token that has the role “arm”.",
    clearQuestion: (number) => `Clear e-stop ${number} only if a person at the display has checked that it is safe. ` +
        "The display is disarmed then.",
    clearFailed: (message) => `The e-stop still holds: ${sentence(message)}`,
    // Pad
    padOffline: "Not connected: strokes are not sent.",
    padEstopped: "An e-stop holds: nothing is felt.",
    padLost: "Playback was lost and starts again. Strokes are not sent.",
    padMayNotPlay: "This page may not play without a token that has the role “play”.",
    padSelectAndArm: "Select a texture, arm the display, then stroke here.",
    padDisarmed: "The display is disarmed: nothing is felt. Arm it, then stroke here.",
    padSelect: "Select a texture, then stroke here.",
    fingerOfAnother: "Another program has the finger. What you do here counts when that program has lifted it.",
    surfaceScale: (texture, lowest_um, highest_um) => `${texture}: dark ${signed(lowest_um)} µm, light ${signed(highest_um)} µm`,
    noPicture: (message) => `The surface could not be drawn: ${sentence(message)}`,
    lifted: "Not touching",
    finger: (x_mm, y_mm, speed_mm_s, force_n) => `x ${x_mm.toFixed(1)} mm, y ${y_mm.toFixed(1)} mm · ${speed_mm_s.toFixed(0)} mm/s · ` +
        `${force_n.toFixed(2)} N`,
    // Contactors
    arrayInShort: (shear_um, drive_v, limit_v) => (shear_um === undefined ? "" : `${shear_um.toFixed(1)} µm · `) +
        `${drive_v.toFixed(0)} V of ${limit_v} V`,
    array: (count, shear_um, drive_v, limit_v) => (shear_um === undefined ? "" : `Largest shear ${shear_um.toFixed(1)} µm. `) +
        `Largest drive ${drive_v.toFixed(0)} V of ${limit_v} V. ` +
        `${count} contactors.`,
    arrayUnknown: "Not known now",
    arrayStill: (limit_v) => "The contactors are drawn at rest, because this device asks for little motion. " +
        `Bars: drive up to ${limit_v} V.`,
    arrayScale: (um_per_mm, limit_v) => um_per_mm === undefined
        ? `This link does not report shears. The bars show the drive, up to ${limit_v} V.`
        : `${um_per_mm} µm are drawn as 1 mm. Bars: drive up to ${limit_v} V. ` +
            "Lines: range of the shear in the last 0.3 s.",
    // One contactor
    chooseContactor: "Click a contactor to see its spectrum.",
    frequencyTick: (frequency_hz) => frequency_hz === 10 ? "10 Hz" : frequency_hz === 1000 ? "1 kHz" : String(frequency_hz),
    shearTick: (shear_um) => (shear_um === 100 ? "100 µm" : String(shear_um)),
    threshold: "Detection threshold",
    bars: "Peak per third octave",
    barsAndPlayed: "Bars: commanded. Lines: on the skin",
    strongest: (level_db, frequency_hz) => `Strongest: ${level_db.toFixed(0)} dB above threshold at ${frequency_hz} Hz`,
    onSkin: (level_db) => `, ${level_db.toFixed(0)} dB on the skin`,
    belowThreshold: "Below threshold everywhere",
    nothingPlays: "Nothing plays",
    noTrace: "This link takes spectra: there are no samples to show, or to listen to.",
    spectrum: (contactor, [x_mm, y_mm], summary) => `Shear of contactor ${contactor} at x ${x_mm.toFixed(1)} mm, ` +
        `y ${y_mm.toFixed(1)} mm in third octaves from 10 Hz to 1 kHz, and the detection threshold. ${sentence(summary)}`,
    listenFailed: (message) => `The loudspeaker cannot be used: ${sentence(message)}`,
    // Textures and gain
    provenance: (provenance) => entry(provenances, provenance) ?? `Parameters: ${provenance}`,
    noTextureMatches: (search) => `No texture matches “${search}”.`,
    noTextures: (message) => `The list of textures could not be read: ${sentence(message)} Reload this page to try again.`,
    nothingSelected: "No texture is selected.",
    selected: (left, right) => right ? `Left: ${left}. Right: ${right}` : `Selected: ${left}`,
    sameBeside: "The same texture",
    preparing: (name) => `Preparing ${name} …`,
    selectFailed: (name, message) => `“${name}” cannot be played: ${sentence(message)} Select it again, or another texture.`,
    percent: (percent) => `${percent} %`,
    gainFailed: (message) => `The gain was not changed: ${sentence(message)}`,
    // Health
    link: "Link",
    linkState: (state) => entry(linkStates, state) ?? state,
    latency: "Latency to skin",
    lead: "Lead of the link",
    roundTrip: "Round trip",
    putOut: "Samples",
    fingerLabel: "Finger",
    nobodyTouches: "Not touching",
    thisPageTouches: "This page",
    anotherTouches: "Another program",
    milliseconds: (value) => value === undefined ? "–" : `${value.toFixed(value < 10 ? 1 : 0)} ms`,
    share: (share) => share === null || share === undefined ? "–" : `${(100 * share).toFixed(1)} % put out`,
    counter: (name) => entry(counterNames, name) ?? name.replace(/_/g, " "),
    count: (value) => value.toLocaleString("en"),
    // Token
    tokenWanted: "The server wants a token. It is in the file that token_file or a [[token]] table of the " +
        "server's configuration names; whoever set up the server has it. This page forgets it when " +
        "it is closed.",
    tokenForRoles: "Tokens are in the server's configuration; this page forgets its token when it is closed.",
    roles: (roles, lacking) => `Roles of this page: ${roles.join(", ") || "none"}. It may not ${lacking.join(" and not ")} ` +
        "without a token that has this role; it may always e-stop.",
    // Events
    connectionStates: {
        connecting: "The server does not answer",
        connected: "Connected to the server",
        refused: "Refused by the server",
        closed: "Connection closed",
    },
    event: (display, kind, detail) => `${display}: ${entry(eventKinds, kind) ?? kind}${detail ? ` (${detail})` : ""}`,
};
/** Return the entry of a name that a server sent, which may be that of something every object has. */
function entry(table, name) {
    return Object.prototype.hasOwnProperty.call(table, name) ? table[name] : undefined;
}
/** Return a number with one decimal and, below zero, with a minus sign instead of a hyphen. */
function signed(value) {
    return value.toFixed(1).replace("-", "−");
}
/** Return a text of the server as a sentence: with a capital letter and a full stop. */
function sentence(text) {
    if (!text)
        return "";
    const capital = text.charAt(0).toUpperCase() + text.slice(1);
    return /[.!?]$/.test(capital) ? capital : `${capital}.`;
}
