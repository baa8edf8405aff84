import { Signal } from "./signal.js";
/** The contactor whose spectrum is shown: at first the one nearest to the center of the display. */
export class ContactorChoice {
    constructor(session) {
        /** Emitted when another contactor is chosen, or one of another display. */
        this.changed = new Signal();
        /** Index of the contactor. */
        this.contactor = 0;
        session.displayChanged.on(({ display }) => {
            this.choose(mostCentral(display?.info.contactors_mm ?? []));
        });
    }
    /** Choose a contactor by its index. */
    choose(contactor) {
        this.contactor = contactor;
        this.changed.emit(this);
    }
}
function mostCentral(places_mm) {
    const middle = (values) => (Math.min(...values) + Math.max(...values)) / 2;
    const x_mm = middle(places_mm.map(([x]) => x));
    const y_mm = middle(places_mm.map(([, y]) => y));
    const distances = places_mm.map(([x, y]) => Math.hypot(x - x_mm, y - y_mm));
    return Math.max(distances.indexOf(Math.min(...distances)), 0);
}
