import type { Session } from "./session.js";
import { Signal } from "./signal.js";

/** The contactor whose spectrum is shown: at first the one nearest to the center of the display. */
export class ContactorChoice {
  /** Emitted when another contactor is chosen, or one of another display. */
  readonly changed = new Signal<ContactorChoice>();
  /** Index of the contactor. */
  contactor = 0;

  constructor(session: Session) {
    session.displayChanged.on(({ display }) => {
      this.choose(mostCentral(display?.info.contactors_mm ?? []));
    });
  }

  /** Choose a contactor by its index. */
  choose(contactor: number): void {
    this.contactor = contactor;
    this.changed.emit(this);
  }
}

function mostCentral(places_mm: readonly (readonly [number, number])[]): number {
  const middle = (values: number[]) => (Math.min(...values) + Math.max(...values)) / 2;
  const x_mm = middle(places_mm.map(([x]) => x));
  const y_mm = middle(places_mm.map(([, y]) => y));
  const distances = places_mm.map(([x, y]) => Math.hypot(x - x_mm, y - y_mm));
  return Math.max(distances.indexOf(Math.min(...distances)), 0);
}
