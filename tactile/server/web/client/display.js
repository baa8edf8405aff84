/** One display of a server, with one finger on it. */
import { now_us } from "./clock.js";
import { ClientError } from "./errors.js";
/** Normal force where a program knows only that there is contact [N]. Assumed: light exploration. */
export const NORMAL_FORCE_N = 0.5;
/** One display; get it from `Connection.display`. It stays the same over reconnections. */
export class Display {
    constructor(connection, name) {
        this.connection = connection;
        this.name = name;
        this.position_mm = [0, 0];
        this.latestInfo = this.presentInfo;
    }
    /**
     * Contactors and limits of the display; those that it had last if the server has no such display
     * any more, as after a reconnection to one with another configuration. Throws if it never had.
     */
    get info() {
        this.latestInfo = this.presentInfo ?? this.latestInfo;
        if (this.latestInfo)
            return this.latestInfo;
        throw new ClientError(`no display ${JSON.stringify(this.name)}`);
    }
    get presentInfo() {
        return this.connection.welcome?.displays.find(({ name }) => name === this.name);
    }
    /** Number of the e-stop that holds as far as the server last reported, 0 for none. */
    get estopped() {
        return this.connection.memory(this.name).estop;
    }
    /** Number of contacts that were not sent: too many, or the server was not there. */
    get droppedContacts() {
        return this.connection.memory(this.name).droppedContacts;
    }
    /** Number of messages of tactile frames that were not sent. */
    get droppedFrames() {
        return this.connection.memory(this.name).droppedFrames;
    }
    /**
     * Say where the finger is. This never waits, and never throws because of the network: a contact
     * that cannot be sent now is counted.
     *
     * @param position_mm Position x, y on the surface [mm].
     */
    touch(position_mm, options = {}) {
        this.position_mm = position_mm;
        this.connection.sendContact({
            type: "contact",
            display: this.name,
            position_mm,
            normal_force_n: options.normal_force_n ?? NORMAL_FORCE_N,
            time_us: options.time_us ?? now_us(),
            ...(options.velocity_mm_s && { velocity_mm_s: options.velocity_mm_s }),
        });
    }
    /**
     * Say that the finger has left the surface.
     *
     * @param time_us Time of that on the clock of `performance.now()` [µs]; by default now.
     */
    lift(time_us = now_us()) {
        this.touch(this.position_mm, { normal_force_n: 0, time_us });
    }
    /**
     * Choose what the finger feels; the old and the new texture cross-fade.
     *
     * @param layers Name of a texture, a layer with its gain, or several of these, which are added
     *   up; `[]` for nothing.
     */
    async select(layers) {
        const list = Array.isArray(layers) ? layers : [layers];
        const named = list.map((layer) => (typeof layer === "string" ? { texture: layer } : layer));
        await this.connection.request({ type: "select", display: this.name, layers: named });
    }
    /**
     * Scale everything that this program plays.
     *
     * @param gain Factor, 0 to 1.
     */
    async gain(gain) {
        await this.connection.request({ type: "gain", display: this.name, gain });
    }
    /** Fade out: textures until `resume`, waveforms for good. */
    async stop() {
        await this.connection.request({ type: "stop", display: this.name });
    }
    /** Let the textures play again after `stop`. */
    async resume() {
        await this.connection.request({ type: "play", display: this.name });
    }
    /** Switch high voltage on. A person should know of it. It is never repeated by this client. */
    async arm() {
        await this.connection.request({ type: "arm", display: this.name });
    }
    /** Fade out and switch high voltage off. */
    async disarm() {
        await this.connection.request({ type: "disarm", display: this.name });
    }
    /**
     * Set this display to 0 V at once, until `clear`. If the server is not there, or does not
     * confirm, the promise is rejected, and the e-stop is sent first over the next connection.
     *
     * @returns Number of the e-stop, which `clear` takes.
     */
    async estop() {
        const done = await this.connection.request({ type: "estop", display: this.name });
        return done.estops?.[this.name] ?? 0;
    }
    /**
     * End an e-stop, after a person has decided so; the display is disarmed then.
     *
     * @param estop Number of the e-stop, by default the one that holds; a newer one still holds.
     */
    async clear(estop = this.estopped) {
        const number = estop || (await this.stats()).estop;
        if (!number)
            return;
        await this.connection.request({ type: "clear", display: this.name, estop: number });
    }
    /**
     * Queue a waveform of tangential shear, as XR_FB_haptic_pcm does.
     *
     * @param samples Samples −1 to 1, at most `MOST_SAMPLES`.
     * @returns How many of the samples were taken; send the rest again.
     */
    append(samples, waveform) {
        return this.connection.request({
            type: "append",
            display: this.name,
            samples: Array.isArray(samples) ? samples : littleEndian(samples),
            ...waveform,
        });
    }
    /**
     * Stream tactile frames: the shear of every contactor at one instant each. This never waits, and
     * never throws because of the network: frames that cannot be sent now are counted.
     *
     * @param values Values −1 to 1, frame by frame, each with one value for every contactor.
     */
    frames(values, stream) {
        this.connection.sendFrames({
            type: "frames",
            display: this.name,
            frames: Array.isArray(values) ? values : littleEndian(values),
            ...stream,
        });
    }
    /** Play an effect given by curves of amplitude and frequency, as XR_EXT_haptic_parametric does. */
    async effect(effect) {
        await this.connection.request({ type: "effect", display: this.name, ...effect });
    }
    /**
     * Play an effect of the server.
     *
     * @param effect Name of the effect.
     * @param gain Factor of its amplitude, 0 to 1.
     */
    async playEffect(effect, gain = 1) {
        await this.connection.request({ type: "play_effect", display: this.name, effect, gain });
    }
    /** Ask for the state of the display. */
    stats() {
        return this.connection.request({ type: "get_stats", display: this.name });
    }
    /**
     * Call a function with the state of the display at a regular rate, also after a reconnection.
     *
     * @param rate_hz Messages per second [Hz], at most 100. All listeners of a display get the
     *   largest rate that one of them wants.
     * @param contactor Contactor whose commanded shear `trace` holds, see `traceSamples`; there is one
     *   for all listeners of a display, the one that was given last.
     * @returns Function that ends it.
     */
    telemetry(rate_hz, listener, contactor) {
        return this.connection.subscribe(this.name, { rate_hz, contactor }, listener);
    }
}
/** Return the samples of a trace [µm]. */
export function traceSamples(trace) {
    const { buffer, byteOffset, byteLength } = trace.shear_um;
    const view = new DataView(buffer, byteOffset, byteLength);
    return Float32Array.from({ length: byteLength / 4 }, (_, k) => view.getFloat32(4 * k, true));
}
/** Return samples as the bytes that the server takes. */
function littleEndian(samples) {
    const bytes = new Uint8Array(4 * samples.length);
    const view = new DataView(bytes.buffer);
    samples.forEach((sample, k) => view.setFloat32(4 * k, sample, true));
    return bytes;
}
