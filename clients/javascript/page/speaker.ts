import { Schedule } from "./schedule.js";

/** Shear that is full scale [µm]. */
export const FULL_SCALE_UM = 10;
/** Delay with which playing begins [s]. */
const TARGET_S = 0.08;
/** Delay beyond which chunks are skipped [s]. */
const MOST_S = 0.2;
/** Samples that a browser mixes at once: the render quantum of Web Audio. */
const QUANTUM = 128;
/** Time in which the sound fades in and out at gaps, so that nothing clicks [s]. */
const FADE_S = 0.004;
/** Shortest chunk that is played [s]: long enough for both fades. */
const CHUNK_S = 0.01;
/** Time after which the faded sound is switched off [ms]: ten time constants. */
const CLOSE_MS = 10 * 1000 * FADE_S;

/** Plays the shear of a contactor through the loudspeaker, in chunks one after the other. */
export class Speaker {
  private readonly context: AudioContext;
  private readonly volume: GainNode;
  private readonly schedule: Schedule;
  /** Fades in the first chunk, and fades out the last one, of those without a gap between them. */
  private fader: GainNode;
  private fadeOut_s = 0;
  /** Samples that are too few for a chunk, and whether they follow the chunk before. */
  private waiting = new Float32Array(0);
  private follows = false;
  private next = NaN;

  /**
   * Begin to play, which browsers allow after a click only.
   *
   * @param sample_rate_hz Sample rate of the shear; the context has the same, so that nothing is
   *   interpolated where two chunks meet.
   * @param volume Factor, 0 to 1.
   */
  constructor(readonly sample_rate_hz: number, volume: number) {
    this.context = new AudioContext({ sampleRate: sample_rate_hz });
    this.volume = new GainNode(this.context, { gain: volume });
    this.volume.connect(this.context.destination);
    this.fader = new GainNode(this.context);
    const samples = (time_s: number) => Math.round(time_s * sample_rate_hz);
    this.schedule = new Schedule({
      target: samples(TARGET_S),
      most: samples(MOST_S),
      least: QUANTUM + samples(FADE_S),
    });
  }

  /** Number of times at which the sound was interrupted. */
  get gaps(): number {
    return this.schedule.gaps;
  }

  /** Set the volume, 0 to 1. */
  setVolume(volume: number): void {
    this.volume.gain.setTargetAtTime(volume, this.context.currentTime, FADE_S);
  }

  /** Play samples [µm], of which the first has a number. */
  take(first: number, shear_um: Float32Array): void {
    if (first !== this.next) this.startAnew();
    this.next = first + shear_um.length;
    const chunk = new Float32Array(this.waiting.length + shear_um.length);
    chunk.set(this.waiting);
    chunk.set(shear_um, this.waiting.length);
    this.waiting = chunk;
    if (chunk.length >= CHUNK_S * this.sample_rate_hz) this.playWaiting();
  }

  /** Fade out, and play nothing any more. */
  close(): void {
    this.setVolume(0);
    setTimeout(() => void this.context.close(), CLOSE_MS);
  }

  /** Fade between what was there before and what comes now, for example of another contactor. */
  startAnew(): void {
    this.follows = false;
    this.waiting = new Float32Array(0);
  }

  private playWaiting(): void {
    const { context, waiting, sample_rate_hz } = this;
    const now = Math.ceil(context.currentTime * sample_rate_hz);
    const place = this.schedule.place(now, waiting.length, this.follows);
    this.waiting = new Float32Array(0);
    this.follows = true;
    if (place === undefined) return;
    const begin_s = place.begin / sample_rate_hz;
    const end_s = (place.begin + waiting.length) / sample_rate_hz;
    this.fade(place.begins, begin_s, end_s);
    const buffer = new AudioBuffer({ length: waiting.length, sampleRate: sample_rate_hz });
    buffer.copyToChannel(waiting.map(fullScale), 0);
    const source = new AudioBufferSourceNode(context, { buffer });
    source.connect(this.fader);
    source.start(begin_s);
  }

  /** Fade out at the end of the last chunk, which the next one puts off if it comes in time. */
  private fade(begins: boolean, begin_s: number, end_s: number): void {
    if (begins) {
      this.fader = new GainNode(this.context, { gain: 0 });
      this.fader.connect(this.volume);
      this.fader.gain.setValueAtTime(0, begin_s).linearRampToValueAtTime(1, begin_s + FADE_S);
    } else this.fader.gain.cancelScheduledValues(this.fadeOut_s);
    this.fadeOut_s = end_s - FADE_S;
    this.fader.gain.setValueAtTime(1, this.fadeOut_s).linearRampToValueAtTime(0, end_s);
  }
}

/** Return a shear [µm] as a sample −1 to 1; peaks are clipped, and what is no number is silent. */
function fullScale(shear_um: number): number {
  return Math.min(Math.max(shear_um / FULL_SCALE_UM, -1), 1) || 0;
}
