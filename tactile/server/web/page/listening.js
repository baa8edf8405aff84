import { byId, setText, showText } from "./dom.js";
import { Speaker } from "./speaker.js";
import { texts } from "./texts.js";
/** Button and slider that let a person hear the shear of the chosen contactor. */
export class Listening {
    constructor(session) {
        this.session = session;
        this.button = byId("listen");
        this.slider = byId("volume");
        this.button.addEventListener("click", () => (this.speaker ? this.stop() : this.begin()));
        this.slider.addEventListener("input", () => this.setVolume());
        document.addEventListener("visibilitychange", () => document.hidden && this.stop());
        session.displayChanged.on(() => this.stop());
        session.changed.on(() => this.follow());
        this.setVolume();
        this.follow();
    }
    /** Play samples [µm], of which the first has a number. */
    take(sample_rate_hz, first, shear_um) {
        if (!this.speaker)
            return;
        if (sample_rate_hz !== this.speaker.sample_rate_hz)
            return this.stop();
        this.speaker.take(first, shear_um);
        this.button.dataset.gaps = String(this.speaker.gaps); // for tests
    }
    /** Fade, because another contactor was chosen. */
    startAnew() {
        this.speaker?.startAnew();
    }
    begin() {
        const { display } = this.session;
        if (!display)
            return;
        try {
            this.speaker = new Speaker(display.info.sample_rate_hz, this.volume);
            showText(byId("listen-problem"), "");
        }
        catch (error) {
            showText(byId("listen-problem"), texts.listenFailed(error.message));
        }
        this.show();
    }
    stop() {
        this.speaker?.close();
        this.speaker = undefined;
        this.show();
    }
    follow() {
        const { isConnected, display, displayIsGone } = this.session;
        this.button.disabled = !isConnected || displayIsGone || !display?.info.waveforms;
        if (this.button.disabled)
            this.stop();
    }
    show() {
        this.session.hurry("listening", this.speaker !== undefined);
        this.button.setAttribute("aria-pressed", String(this.speaker !== undefined));
    }
    get volume() {
        return Number(this.slider.value) / 100;
    }
    setVolume() {
        const text = texts.percent(Number(this.slider.value));
        setText(byId("volume-value"), text);
        this.slider.setAttribute("aria-valuetext", text);
        this.speaker?.setVolume(this.volume);
    }
}
