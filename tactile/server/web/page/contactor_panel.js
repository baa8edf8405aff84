import { traceSamples } from "../client/index.js";
import { ContactorSpectrum } from "./contactor_spectrum.js";
import { byId, element, setText } from "./dom.js";
import { Listening } from "./listening.js";
import { SpectrumView } from "./spectrum_view.js";
import { texts } from "./texts.js";
import { Threshold } from "./threshold.js";
/** Telemetry messages per second, unless the session wants more: one for each update. */
const TELEMETRY_HZ = 10;
const UPDATE_MS = 100;
/** Time without samples after which nothing plays [ms]. */
const PATIENCE_MS = 300;
/** Time between texts [ms]: they could not be read if they changed as often as the drawing. */
const DESCRIBE_MS = 500;
/** The bands of no spectrum. */
const NOTHING = [];
/** Shows the spectra of commanded and played shear of one contactor, and lets it be heard. */
export class ContactorPanel {
    constructor(session, choice) {
        this.session = session;
        this.choice = choice;
        this.view = new SpectrumView(byId("spectrum"));
        this.select = byId("contactor");
        this.places_mm = [];
        this.threshold = new Threshold([]);
        this.commanded = new TracedSpectrum();
        this.played = new TracedSpectrum();
        this.updated_ms = 0;
        this.unsubscribe = () => { };
        this.listening = new Listening(session);
        this.select.addEventListener("change", () => choice.choose(this.select.selectedIndex));
        choice.changed.on(() => this.follow());
        setInterval(() => this.update(performance.now()), UPDATE_MS);
        setInterval(() => this.describe(), DESCRIBE_MS);
    }
    /** Show the contactor that is chosen now. */
    follow() {
        const { display } = this.session;
        if (display !== this.display)
            this.showDisplay(display);
        const { contactor } = this.choice;
        this.select.selectedIndex = contactor;
        this.commanded.startAnew(this.threshold);
        this.played.startAnew(this.threshold);
        this.listening.startAnew();
        this.unsubscribe();
        const take = (telemetry) => this.take(telemetry);
        this.unsubscribe = display?.telemetry(TELEMETRY_HZ, take, contactor) ?? (() => { });
        this.update(performance.now());
        this.describe();
    }
    showDisplay(display) {
        this.display = display;
        this.places_mm = display?.info.contactors_mm ?? [];
        this.select.replaceChildren(...this.places_mm.map((_, k) => element("option", String(k))));
        this.threshold = new Threshold(display?.info.threshold_um ?? []);
    }
    take({ trace, played }) {
        if (played?.contactor === this.choice.contactor)
            this.played.take(played);
        if (!trace?.shear_um.length || trace.contactor !== this.choice.contactor)
            return;
        const samples = this.commanded.take(trace);
        this.listening.take(trace.sample_rate_hz, trace.first, samples);
    }
    update(now_ms) {
        const passed_s = (now_ms - this.updated_ms) / 1000;
        this.updated_ms = now_ms;
        const [commanded, played] = [this.commanded, this.played].map((spectrum) => spectrum.update(now_ms, passed_s));
        this.view.show(commanded ?? NOTHING, played ?? NOTHING, this.threshold);
    }
    describe() {
        const sentence = this.sentence();
        setText(byId("spectrum-summary"), sentence);
        const { contactor } = this.choice;
        const place_mm = this.places_mm[contactor] ?? [0, 0];
        const label = texts.spectrum(contactor, place_mm, sentence + this.onSkin());
        byId("spectrum").setAttribute("aria-label", label);
    }
    sentence() {
        const { strongest } = this.commanded;
        if (this.display?.info.waveforms === false)
            return texts.noTrace;
        if (!strongest)
            return texts.nothingPlays;
        const { level_db, band } = strongest;
        return level_db > 0 ? texts.strongest(level_db, band.nominal_hz) : texts.belowThreshold;
    }
    /** Return what the lines of the drawing say of the strongest band. */
    onSkin() {
        const { strongest } = this.commanded;
        const played = this.played.bands.find(({ band }) => band === strongest?.band);
        return played ? texts.onSkin(played.level_db) : "";
    }
}
/** Spectrum of a trace that may end, and begin again with another sample rate. */
class TracedSpectrum {
    constructor() {
        this.threshold = new Threshold([]);
        this.sample_rate_hz = 0;
        this.received_ms = 0;
    }
    /** Bands of the spectrum; none while nothing plays. */
    get bands() {
        return this.spectrum?.bands ?? NOTHING;
    }
    /** Band with the highest sensation level; undefined while nothing plays. */
    get strongest() {
        return this.spectrum?.strongest;
    }
    /** Forget the samples, as those of another contactor follow. */
    startAnew(threshold) {
        this.threshold = threshold;
        this.spectrum = undefined;
    }
    /** Take the samples of a message, and return them [µm]. */
    take(trace) {
        const samples = traceSamples(trace);
        if (samples.length === 0)
            return samples;
        this.received_ms = performance.now();
        if (!this.spectrum || trace.sample_rate_hz !== this.sample_rate_hz) {
            this.sample_rate_hz = trace.sample_rate_hz;
            this.spectrum = new ContactorSpectrum(trace.sample_rate_hz, this.threshold);
        }
        this.spectrum.take(trace.first, samples);
        return samples;
    }
    /** Compute the bands as of a time, and return them. */
    update(now_ms, passed_s) {
        if (now_ms - this.received_ms > PATIENCE_MS)
            this.spectrum?.clear();
        else
            this.spectrum?.update(passed_s);
        return this.bands;
    }
}
