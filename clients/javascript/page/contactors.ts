import type { DisplayDescription, TelemetryMessage } from "../client/index.js";
import { ShearScale } from "./shear_scale.js";

/** Share of the distance to the nearest neighbor that a contactor may be drawn away. */
export const ROOM = 0.42;
/** Half of the time over which the extent of the shear is taken [ms]. */
const HALF_EXTENT_MS = 150;

/** One contactor, with its present shear and drive. */
export interface Contactor {
  readonly x_mm: number;
  readonly y_mm: number;
  /** Direction of its shear, as a unit vector. */
  readonly along: number;
  readonly up: number;
  drive_v: number;
  shear_um: number;
  readonly extent: Extent;
}

/** Smallest and largest value of the last 0.3 s, or half of that just after the halves change. */
class Extent {
  private least = 0;
  private most = 0;
  private earlierLeast = 0;
  private earlierMost = 0;

  get from(): number {
    return Math.min(this.least, this.earlierLeast);
  }

  get to(): number {
    return Math.max(this.most, this.earlierMost);
  }

  add(value: number): void {
    if (value < this.least) this.least = value;
    if (value > this.most) this.most = value;
  }

  begin(value: number): void {
    [this.earlierLeast, this.earlierMost] = [this.least, this.most];
    [this.least, this.most] = [value, value];
  }
}

/** The contactors of one display, with their present shears and drives. */
export class Contactors {
  readonly all: readonly Contactor[];
  readonly pitch_mm: number;
  readonly limit_v: number;
  readonly scale: ShearScale;
  /** Whether the link reports shears, as it does unless it takes spectrum frames. */
  hasShear = true;
  isArmed = false;
  largestShear_um = 0;
  largestDrive_v = 0;
  private halfBegan_ms = 0;
  private moved_ms = -Infinity;

  constructor(info: DisplayDescription) {
    this.all = info.contactors_mm.map(([x_mm, y_mm], k) => {
      const angle = ((info.shear_direction_deg[k] ?? 0) * Math.PI) / 180;
      const [along, up] = [Math.cos(angle), Math.sin(angle)];
      return { x_mm, y_mm, along, up, drive_v: 0, shear_um: 0, extent: new Extent() };
    });
    this.limit_v = info.voltage_limit_v;
    this.pitch_mm = smallestDistance(this.all);
    this.scale = new ShearScale(ROOM * this.pitch_mm);
  }

  /**
   * Take the present shears and drives. Those of a display that is not armed are old.
   *
   * @returns Whether anything is to be drawn anew: something moves, or has an extent of before.
   */
  take({ state, drive_v, shear_um }: TelemetryMessage, time_ms: number): boolean {
    this.isArmed = state === "armed";
    const begins = time_ms - this.halfBegan_ms > HALF_EXTENT_MS;
    if (begins) this.halfBegan_ms = time_ms;
    this.hasShear = shear_um !== null;
    this.largestShear_um = this.largestDrive_v = 0;
    for (const [k, contactor] of this.all.entries()) {
      contactor.drive_v = (this.isArmed && drive_v[k]) || 0;
      contactor.shear_um = (this.isArmed && shear_um?.[k]) || 0;
      if (begins) contactor.extent.begin(contactor.shear_um);
      else contactor.extent.add(contactor.shear_um);
      this.largestDrive_v = Math.max(this.largestDrive_v, Math.abs(contactor.drive_v));
      this.largestShear_um = Math.max(this.largestShear_um, Math.abs(contactor.shear_um));
    }
    this.scale.take(this.largestShear_um, time_ms);
    if (this.largestShear_um > 0 || this.largestDrive_v > 0) this.moved_ms = time_ms;
    return time_ms - this.moved_ms < 3 * HALF_EXTENT_MS;
  }
}

/** Return the distance of the two nearest contactors; that of a fingertip if there is only one. */
function smallestDistance(contactors: readonly Contactor[]): number {
  let least = Infinity;
  for (const [k, one] of contactors.entries()) {
    for (const other of contactors.slice(k + 1)) {
      least = Math.min(least, Math.hypot(one.x_mm - other.x_mm, one.y_mm - other.y_mm));
    }
  }
  return Number.isFinite(least) && least > 0 ? least : 10;
}
