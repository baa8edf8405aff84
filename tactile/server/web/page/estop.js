import { Question } from "./dialogs.js";
import { byId, setText } from "./dom.js";
import { texts } from "./texts.js";
/** Time after which an e-stop without an answer is taken for unconfirmed [ms]. */
const PATIENCE_MS = 500;
/** Time after a pointer went down in which a click is the same press [ms]. */
const SAME_PRESS_MS = 1000;
/** The e-stop: its button, the Escape key, and the panel that shows and clears it. */
export class EStopControl {
    constructor(session, notice) {
        this.session = session;
        this.notice = notice;
        this.question = new Question("clear", () => void this.clear());
        this.panel = byId("estop-panel");
        /** Whether an e-stop of this page has not been confirmed yet. */
        this.isOpen = false;
        /** Whether the client will send it over the next connection, and nobody waits for the answer. */
        this.isKept = false;
        this.patience = 0;
        /** Number of the e-stop that the question is about. */
        this.number = 0;
        this.pressed_ms = -Infinity;
        byId("estop").addEventListener("pointerdown", (event) => this.pressByPointer(event));
        byId("estop").addEventListener("click", (event) => this.click(event));
        byId("clear").addEventListener("click", () => this.askToClear());
        addEventListener("keydown", (event) => this.pressKey(event), { capture: true });
        session.changed.on(() => this.show());
        session.reopened.on(() => this.isOpen && this.send());
        this.show();
    }
    /** Stop when the button goes down: a click comes only when it is released over the button. */
    pressByPointer(event) {
        this.pressed_ms = event.timeStamp;
        this.press();
    }
    /** Stop by the keyboard or an assistive device, or by a pointer whose click is not that press. */
    click(event) {
        if (event.timeStamp - this.pressed_ms > SAME_PRESS_MS)
            this.press();
    }
    pressKey(event) {
        if (event.key !== "Escape")
            return;
        event.preventDefault(); // it would close a dialog or empty the search field
        if (!event.repeat)
            this.press();
    }
    press() {
        this.isOpen = true;
        this.send();
        clearTimeout(this.patience);
        if (this.session.isConnected) {
            this.patience = window.setTimeout(() => this.warn(), PATIENCE_MS);
        }
        else
            this.warn();
    }
    /** Stop all displays: whoever presses the button need not know which one is at fault. */
    send() {
        this.isKept = false;
        this.session.connection.estop().then(() => this.confirm(), () => {
            this.isKept = true;
            this.warn();
        });
    }
    warn() {
        if (this.isOpen)
            this.notice.show(texts.estopUnconfirmed, "danger");
    }
    confirm() {
        if (!this.isOpen)
            return;
        this.isOpen = false;
        clearTimeout(this.patience);
        this.notice.hide();
        void this.session.askStats();
    }
    show() {
        const { session } = this;
        const holds = session.state === "estopped";
        if (holds && this.isKept)
            this.confirm();
        if (!holds)
            this.question.close();
        this.panel.hidden = !holds;
        if (!holds)
            return;
        const reason = session.latestStats?.detail ?? "";
        setText(byId("estop-reason"), texts.estopReason(this.holding(), reason));
        const mayClear = session.may("arm");
        byId("clear").disabled = !mayClear;
        setText(byId("clear-hint"), mayClear ? texts.clearHint : texts.mayNotClear);
    }
    holding() {
        return this.session.latestStats?.estop || this.session.display?.estopped || 0;
    }
    askToClear() {
        this.number = this.holding();
        setText(byId("clear-question"), texts.clearQuestion(this.number));
        this.question.ask();
    }
    async clear() {
        try {
            await this.session.display?.clear(this.number);
        }
        catch (error) {
            this.notice.show(texts.clearFailed(error.message));
        }
        void this.session.askStats();
    }
}
