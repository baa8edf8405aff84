import { byId } from "./dom.js";

/** A question with two answers. It is not modal, so that the e-stop stays within reach. */
export class Question {
  private readonly dialog: HTMLDialogElement;
  private asker: Element | null = null;

  /**
   * @param id Id of the dialog; those of its buttons end in "-confirm" and "-cancel".
   * @param confirmed Called if the user confirms.
   */
  constructor(private readonly id: string, confirmed: () => void) {
    this.dialog = byId<HTMLDialogElement>(`${id}-dialog`);
    byId(`${id}-cancel`).addEventListener("click", () => this.close());
    byId(`${id}-confirm`).addEventListener("click", () => {
      this.close();
      confirmed();
    });
  }

  /** Ask. The focus goes to the button that changes nothing. */
  ask(): void {
    this.asker = document.activeElement;
    if (!this.dialog.open) this.dialog.show();
    byId(`${this.id}-cancel`).focus();
  }

  /** Take the question back. */
  close(): void {
    if (!this.dialog.open) return;
    this.dialog.close();
    if (this.asker instanceof HTMLElement) this.asker.focus();
  }
}
