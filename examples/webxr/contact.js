/**
 * Contact of a fingertip with the board, in the frame of the board: from the center of its tiles, x
 * to the right, y upward along it, and z out of it.
 */

export const WIDTH_MM = 500;
export const HEIGHT_MM = 200;
/** Depth at which contact begins [mm]; it ends at 0, so that trembling does not flicker. */
const BEGINS_MM = 1;
/** Depth from which the finger is taken to be behind the board [mm]. */
const BEHIND_MM = 50;
/** Force per depth [N/mm] and its limit [N]: a board has no depth, so this is assumed. */
const STIFFNESS = 0.1;
const STRONGEST_N = 1;

/** Return the pose of the board: 1.1 m high, 0.45 m ahead, its top tilted back by 30°. */
export function boardPose() {
  const half = Math.PI / 12; // of the angle, for the quaternion
  const orientation = { x: -Math.sin(half), y: 0, z: 0, w: Math.cos(half) };
  return new XRRigidTransform({ x: 0, y: 1.1, z: -0.45 }, orientation);
}

/**
 * Locate the fingertip of a hand, or the tip of a controller.
 *
 * @param {XRFrame} frame
 * @param {XRInputSource} source
 * @param {XRReferenceSpace} floor Space in which the board has its pose.
 * @returns {{x: number, y: number, z: number, depth: number} | undefined} Position on the board and
 *   depth in it [mm]; undefined if the tip is not tracked.
 */
export function locateTip(frame, source, floor) {
  if (source.targetRayMode !== "tracked-pointer") return undefined;
  const joint = source.hand?.get("index-finger-tip");
  const pose = joint
    ? frame.getJointPose(joint, floor)
    : frame.getPose(source.targetRaySpace, floor);
  if (!pose) return undefined;
  const toBoard = DOMMatrixReadOnly.fromFloat32Array(boardPose().inverse.matrix);
  const { x, y, z } = DOMPointReadOnly.fromPoint(pose.transform.position).matrixTransform(toBoard);
  const skin = pose.radius ?? 0; // a joint is inside the finger
  return { x: 1000 * x, y: 1000 * y, z: 1000 * z, depth: 1000 * (skin - z) };
}

/**
 * Return the normal force of a tip [N]; 0 if it does not touch.
 *
 * @param {{x: number, y: number, depth: number}} tip
 * @param {boolean} touched Whether it touched in the frame before.
 */
export function normalForce({ x, y, depth }, touched) {
  const over = Math.abs(x) <= WIDTH_MM / 2 && Math.abs(y) <= HEIGHT_MM / 2;
  const touches = over && depth > (touched ? 0 : BEGINS_MM) && depth < BEHIND_MM;
  return touches ? Math.min(STIFFNESS * depth, STRONGEST_N) : 0;
}
