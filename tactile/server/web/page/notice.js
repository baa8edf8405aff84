import { byId, setText } from "./dom.js";
/** One sentence about something that did not work, until the user closes it. */
export class Notice {
    constructor() {
        this.box = byId("notice");
        byId("notice-close").addEventListener("click", () => this.hide());
    }
    /** Show a sentence, instead of the one before. */
    show(text, severity = "warning") {
        this.box.dataset.severity = severity;
        this.box.hidden = false;
        setText(byId("notice-text"), text);
    }
    /** Take the sentence back. */
    hide() {
        this.box.hidden = true;
    }
}
