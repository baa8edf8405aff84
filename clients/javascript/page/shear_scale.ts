/** Time in which the maximum that is remembered falls to 1/e [ms]. */
const DECAY_MS = 3000;
/** Smallest maximum [µm]: less is not felt, and would only be drawn as restlessness. */
const FLOOR_UM = 2;
/** Largest maximum [µm]: one that is beyond all displays would be remembered for minutes. */
const MOST_UM = 1000;
const STEPS = [1, 2, 5];

/** Scale at which shears are drawn: as large as fits beside the neighbor, and a round number. */
export class ShearScale {
  private most_um = FLOOR_UM;
  private latest_ms = 0;
  /** Shear that is drawn as 1 mm of the display [µm]. */
  um_per_mm: number;

  /** @param room_mm How far a contactor may be drawn from its place [mm]. */
  constructor(private readonly room_mm: number) {
    this.um_per_mm = roundUp(FLOOR_UM / room_mm);
  }

  /** Take the largest magnitude of the present shears [µm]. */
  take(magnitude_um: number, time_ms: number): void {
    const decay = Math.exp((this.latest_ms - time_ms) / DECAY_MS);
    this.latest_ms = time_ms;
    const taken_um = Math.min(magnitude_um, MOST_UM);
    this.most_um = Math.max(taken_um, this.most_um * decay, FLOOR_UM);
    const wanted = roundUp(this.most_um / this.room_mm);
    // The scale grows at once, but shrinks only well below the next one: it should not flicker.
    if (wanted > this.um_per_mm || 1.6 * this.most_um < this.um_per_mm * this.room_mm) {
      this.um_per_mm = wanted;
    }
  }
}

/** Return the smallest of 1, 2, 5, 10, 20 … that is not below a value. */
function roundUp(value: number): number {
  const decade = 10 ** Math.floor(Math.log10(value));
  const step = STEPS.find((factor) => factor * decade >= value * (1 - 1e-9));
  return step === undefined ? 10 * decade : step * decade;
}
