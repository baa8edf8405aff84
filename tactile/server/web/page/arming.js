import { Question } from "./dialogs.js";
import { byId, setText } from "./dom.js";
import { texts } from "./texts.js";
/** Buttons that arm, after a question, and disarm at once. */
export class Arming {
    constructor(session, notice) {
        this.session = session;
        this.notice = notice;
        this.armButton = byId("arm");
        this.disarmButton = byId("disarm");
        this.question = new Question("arm", () => void this.arm());
        this.armButton.addEventListener("click", () => this.ask());
        this.disarmButton.addEventListener("click", () => void this.disarm());
        session.changed.on(() => this.show());
        this.show();
    }
    ask() {
        const { display } = this.session;
        if (!display)
            return;
        setText(byId("arm-question"), texts.armQuestion(display.name, display.info.voltage_limit_v));
        this.question.ask();
    }
    async arm() {
        try {
            await this.session.display?.arm();
            this.notice.hide(); // it may say why the display was disarmed
        }
        catch (error) {
            this.notice.show(texts.armFailed(error.message));
        }
        void this.session.askStats();
    }
    async disarm() {
        try {
            await this.session.display?.disarm();
        }
        catch (error) {
            this.notice.show(texts.disarmFailed(error.message));
        }
        void this.session.askStats();
    }
    show() {
        const { session } = this;
        const isArmed = session.state === "armed";
        const hasFocus = document.activeElement === (isArmed ? this.armButton : this.disarmButton);
        this.armButton.hidden = isArmed;
        this.disarmButton.hidden = !isArmed;
        // The button that had the focus is gone now; its place is taken by the other one.
        if (hasFocus)
            (isArmed ? this.disarmButton : this.armButton).focus();
        this.armButton.disabled = session.state !== "disarmed" || !session.may("arm");
        this.disarmButton.disabled = !session.may("arm") && !session.may("stop");
        if (session.state !== "disarmed")
            this.question.close();
    }
}
