/** A hand or a controller strokes a board in VR or AR, and `tactile serve` plays its textures. */

import { connect } from "tactile-client";
import { Board, TILES, TILE_MM } from "./board.js";
import { locateTip, normalForce, WIDTH_MM } from "./contact.js";

const SERVER = new URLSearchParams(location.search).get("server") ?? "ws://127.0.0.1:7411/v1";
/** Distance beyond a tile's edge at which its neighbor is selected [mm], so as not to flicker. */
const EDGE_MM = 3;
const COLORS = { armed: "#00695c", disarmed: "#37474f", problem: "#b00020" };

const element = (id) => document.getElementById(id);
const connection = connect({ url: SERVER, client: "webxr" });

let display; // of the server, once it is there
let state = "unknown"; // of the display
let floor; // reference space of the session
let finger = ""; // what the hand does, as a text
let touching; // input source that touches the board
let last_us = 0; // time of the last contact
let tile; // index of the selected tile

/** Wait for a request that a person made, and show why it failed. */
async function request(promise) {
  const problem = await promise.then(() => "", (error) => error.message);
  element("problem").textContent = problem;
}

/** Wait for what nobody pressed a button for; it hides no problem of a button. */
async function follow(promise) {
  await promise.catch((error) => (element("problem").textContent = error.message));
}

// The e-stop first, so that it works whatever happens after it

const estop = () => request((display ?? connection).estop()); // without a server it is sent later
element("estop").onclick = estop;
addEventListener("keydown", ({ key }) => key === "Escape" && estop());

// The page

const gl = document.createElement("canvas").getContext("webgl2", { xrCompatible: true });
if (!gl) element("problem").textContent = "this browser has no WebGL 2, which the board needs";
const board = new Board(gl);

/** Show what is the case on the page and on the board. */
function show() {
  const connected = connection.state === "connected";
  const text = connected
    ? state + (finger && `, ${finger}`)
    : `no server: ${connection.reason}; is ${location.origin} among its "origins"?`;
  const color = (connected && COLORS[state]) || COLORS.problem;
  element("arm").disabled = !display || !connected || state !== "disarmed";
  element("disarm").disabled = !display || state !== "armed";
  element("clear").disabled = !display || state !== "estopped";
  const status = element("status");
  if (status.textContent === text && status.dataset.color === color) return;
  status.textContent = text;
  status.style.borderColor = status.dataset.color = color;
  board.show(text, color);
}

element("arm").onclick = () => request(display.arm());
element("disarm").onclick = () => request(display.disarm());
element("clear").onclick = () => request(display.clear());
for (const mode of ["immersive-vr", "immersive-ar"]) {
  element(mode).onclick = () => request(enter(mode));
  navigator.xr?.isSessionSupported(mode).then((is) => (element(mode).disabled = !is));
}
if (!navigator.xr) element("problem").textContent = "this browser has no WebXR here: see README.md";

// The server

connection.on("state", () => {
  const isThere = connection.displays.some(({ name }) => name === display?.name);
  if (connection.state !== "connected" || !isThere) state = "unknown";
  if (connection.state === "connected") {
    tile = undefined; // select it again, whatever was missed
    follow(paintSurfaces());
  }
  show();
});
show();
follow(
  connection.ready().then(() => {
    display = connection.display();
    display.telemetry(10, (telemetry) => {
      state = telemetry.state;
      show();
    });
  }),
);

/** Paint the tiles with their surfaces, as the finger meets them there. */
async function paintSurfaces() {
  for (const index of TILES.keys()) {
    board.paintSurface(index, await connection.drawTexture(board.section(index)));
  }
}

// The session

async function enter(mode) {
  const session = await navigator.xr.requestSession(mode, {
    requiredFeatures: ["local-floor"],
    optionalFeatures: ["hand-tracking"],
  });
  session.onend = () => {
    lift("");
    if (display) follow(display.disarm()); // nobody sees the board any more
  };
  session.onvisibilitychange = () => session.visibilityState !== "visible" && lift("paused");
  session.onsqueezestart = estop;
  session.onselectstart = ({ inputSource }) => inputSource.hand && estop(); // a pinch
  session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
  floor = await session.requestReferenceSpace("local-floor");
  session.requestAnimationFrame(onFrame);
}

function onFrame(time, frame) {
  const { session } = frame;
  session.requestAnimationFrame(onFrame);
  const tips = [];
  for (const source of session.inputSources) {
    const tip = locateTip(frame, source, floor);
    if (tip) tips.push({ ...tip, source, force: normalForce(tip, source === touching) });
  }
  // the pose is a prediction for the time at which the frame is displayed
  play(tips, Math.round(1000 * (frame.predictedDisplayTime ?? time)));
  show();
  board.draw(frame, floor, tips.map((tip) => ({ ...tip, touches: tip.source === touching })));
}

/** Play for the first tip that touches, until it is lifted; a display has one finger. */
function play(tips, time_us) {
  const mayTouch = ({ source, force }) => force > 0 && source === (touching ?? source);
  const tip = display && tips.find(mayTouch);
  if (!tip) return lift(tips.length > 0 ? "lifted" : "no hand or controller is tracked", time_us);
  touching = tip.source;
  select(tip.x);
  finger = `on ${TILES[tile].texture}`;
  display.touch([tip.x, tip.y], { normal_force_n: tip.force, time_us });
  last_us = time_us;
}

/** Lift the finger if it touches; a lift that is older than the last contact would be ignored. */
function lift(text, time_us = Math.round(1000 * performance.now())) {
  if (touching) display.lift(Math.max(time_us, last_us + 1000));
  touching = undefined;
  finger = text;
  show();
}

/** Select the texture of the tile at x [mm]. */
function select(x) {
  const place = (x + WIDTH_MM / 2) / TILE_MM;
  if (Math.abs(place - tile - 0.5) < 0.5 + EDGE_MM / TILE_MM) return;
  tile = Math.min(Math.floor(place), TILES.length - 1);
  follow(display.select(TILES[tile].texture));
}
