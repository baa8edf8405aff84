/** Time in which the maximum that is remembered falls to 1/e [ms]. */
const DECAY_MS = 3000;
/** Smallest maximum [µm]: less is not felt, and would only be drawn as restlessness. */
const FLOOR_UM = 2;
/** Largest maximum [µm]: one that is beyond all displays would be remembered for minutes. */
const MOST_UM = 1000;
const STEPS = [1, 2, 5];
/** Scale at which shears are drawn: as large as fits beside the neighbor, and a round number. */
export class ShearScale {
    /** @param room_mm How far a contactor may be drawn from its place [mm]. */
    constructor(room_mm) {
        this.room_mm = room_mm;
        this.most_um = FLOOR_UM;
        this.latest_ms = 0;
        this.um_per_mm = roundUp(FLOOR_UM / room_mm);
    }
    /** Take the largest magnitude of the present shears [µm]. */
    take(magnitude_um, time_ms) {
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
function roundUp(value) {
    const decade = 10 ** Math.floor(Math.log10(value));
    const step = STEPS.find((factor) => factor * decade >= value * (1 - 1e-9));
    return step === undefined ? 10 * decade : step * decade;
}
