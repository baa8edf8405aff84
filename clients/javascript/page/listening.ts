import { byId, setText, showText } from "./dom.js";
import type { Session } from "./session.js";
import { Speaker } from "./speaker.js";
import { texts } from "./texts.js";

/** Button and slider that let a person hear the shear of the chosen contactor. */
export class Listening {
  private readonly button = byId<HTMLButtonElement>("listen");
  private readonly slider = byId<HTMLInputElement>("volume");
  private speaker: Speaker | undefined;

  constructor(private readonly session: Session) {
    this.button.addEventListener("click", () => (this.speaker ? this.stop() : this.begin()));
    this.slider.addEventListener("input", () => this.setVolume());
    document.addEventListener("visibilitychange", () => document.hidden && this.stop());
    session.displayChanged.on(() => this.stop());
    session.changed.on(() => this.follow());
    this.setVolume();
    this.follow();
  }

  /** Play samples [µm], of which the first has a number. */
  take(sample_rate_hz: number, first: number, shear_um: Float32Array): void {
    if (!this.speaker) return;
    if (sample_rate_hz !== this.speaker.sample_rate_hz) return this.stop();
    this.speaker.take(first, shear_um);
    this.button.dataset.gaps = String(this.speaker.gaps); // for tests
  }

  /** Fade, because another contactor was chosen. */
  startAnew(): void {
    this.speaker?.startAnew();
  }

  private begin(): void {
    const { display } = this.session;
    if (!display) return;
    try {
      this.speaker = new Speaker(display.info.sample_rate_hz, this.volume);
      showText(byId("listen-problem"), "");
    } catch (error) {
      showText(byId("listen-problem"), texts.listenFailed((error as Error).message));
    }
    this.show();
  }

  private stop(): void {
    this.speaker?.close();
    this.speaker = undefined;
    this.show();
  }

  private follow(): void {
    const { isConnected, display, displayIsGone } = this.session;
    this.button.disabled = !isConnected || displayIsGone || !display?.info.waveforms;
    if (this.button.disabled) this.stop();
  }

  private show(): void {
    this.session.hurry("listening", this.speaker !== undefined);
    this.button.setAttribute("aria-pressed", String(this.speaker !== undefined));
  }

  private get volume(): number {
    return Number(this.slider.value) / 100;
  }

  private setVolume(): void {
    const text = texts.percent(Number(this.slider.value));
    setText(byId("volume-value"), text);
    this.slider.setAttribute("aria-valuetext", text);
    this.speaker?.setVolume(this.volume);
  }
}
