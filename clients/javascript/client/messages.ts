/**
 * Messages of the API with the names and units of tactile/messages.py; written by
 * `python -m clients.generate` from the JSON Schema of that module.
 *
 * A field with a `?` may be absent, which stands for its default.
 */

/** Version of the API that `ClientHello` and `Welcome` carry. */
export const API_VERSION = 1;

/** WebSocket subprotocol of messages in MessagePack. */
export const MSGPACK_PROTOCOL = "tactile.v1.msgpack";

/** Path of the WebSocket in the server's URL. */
export const PATH = "/v1";

/** Largest size of a message [bytes]. */
export const LARGEST_MESSAGE = 65536;

/** Maximum number of textures that one client may select on one display at a time. */
export const MOST_LAYERS = 4;

/**
 * Maximum number of samples of a waveform in one message, as in XR_FB_haptic_pcm
 * (XR_MAX_HAPTIC_PCM_BUFFER_SIZE_FB).
 */
export const MOST_SAMPLES = 4000;

/**
 * Maximum number of points of each curve of a parametric effect in one message, as in
 * XR_EXT_haptic_parametric.
 */
export const MOST_POINTS = 500;

/** Time without a contact after which a touching client is taken to have lifted its finger [s]. */
export const SILENCE = 0.1;

/** Permission of a client; the module docstring says what each role allows. */
export type Role =
  | "watch"
  | "play"
  | "arm"
  | "stop";

/** Kind of a `Failure`. */
export type Code =
  | "malformed"
  | "too_large"
  | "unknown_type"
  | "invalid_field"
  | "unknown_texture"
  | "unknown_effect"
  | "unknown_display"
  | "wrong_version"
  | "unauthorized"
  | "hello_first"
  | "too_many_clients"
  | "too_fast"
  | "not_armed"
  | "estopped"
  | "busy"
  | "unavailable"
  | "unsupported"
  | "internal";

/**
 * First message of a client: its name, the API version that it speaks, and its token.
 *
 * It is answered by `Welcome`, or by a `Failure` after which the server closes the connection.
 */
export interface ClientHello {
  type: "hello";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the program, for logs and for the reason of an e-stop. */
  client: string;
  /**
   * Version of the API that the client speaks.
   * @default 1
   */
  version?: number;
  /**
   * Token that the server's configuration knows; it determines the roles of the client. Empty if
   * the client has none.
   * @default ""
   */
  token?: string;
}

/** Ask for all textures that can be selected; answered by `Textures`. */
export interface ListTextures {
  type: "list_textures";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
}

/**
 * Ask for a picture of a texture's surface; answered by `TexturePicture`.
 *
 * A picture may take a second. It does not delay other requests of the client, so that answers may
 * come in another order, and it waits for textures that are being prepared.
 */
export interface DrawTexture {
  type: "draw_texture";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of a texture, as listed in `Textures`. */
  texture: string;
  /**
   * Seed of the random realization, as in `Layer`.
   * @default 0
   */
  seed?: number;
  /** Coordinate x of the left edge of the picture [mm]. */
  left_mm: number;
  /** Coordinate y of the lower edge [mm]. */
  bottom_mm: number;
  /** Side of a pixel [mm]; a pixel is the mean over its area. */
  pixel_mm: number;
  /** Number of pixels along x. */
  columns: number;
  /** Number of pixels along y; with the columns at most 262 144 pixels in all. */
  rows: number;
}

/** One of the textures that a client superimposes. */
export interface Layer {
  /** Name of a texture, as listed in `Textures`. */
  texture: string;
  /**
   * Factor of the texture's amplitude, 0 to 1. What 1 is, the key `levels` of the server's
   * configuration says: by default the largest that the limits of the display leave unchanged.
   * @default 1.0
   */
  gain?: number;
  /**
   * Seed of the random realization of the texture; the same seed gives the same surface.
   * @default 0
   */
  seed?: number;
}

/**
 * Select the textures that the finger feels of this client; requires the role "play".
 *
 * They replace the client's earlier selection in a cross-fade. `Done` follows once the textures
 * are ready; preparing one may take a second.
 */
export interface Select {
  type: "select";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
  /** Textures to superimpose; an empty list deselects all. */
  layers: Layer[];
}

/**
 * Report where the finger is and how hard it presses; requires the role "play".
 *
 * It is not a request: it has no `id`, and only a contact that cannot be used is answered, by a
 * `Failure`. Send one per frame.
 */
export interface Contact {
  type: "contact";
  /** Name of the display. */
  display: string;
  /** Position x, y of the finger on the surface [mm]. */
  position_mm: [number, number];
  /** Normal force [N]; 0 lifts the finger. */
  normal_force_n: number;
  /**
   * Time at which the finger was there, on the client's monotonic clock [µs]. Without it, the
   * time of arrival is used.
   */
  time_us?: number | null;
  /**
   * Velocity of the finger [mm/s]. If it is given, it is used to predict the next milliseconds,
   * which is more accurate than a prediction from positions alone.
   */
  velocity_mm_s?: [number, number] | null;
}

/**
 * Resume this client's textures after `StopPlaying`; requires the role "play".
 *
 * The textures of a new client sound without it.
 */
export interface Resume {
  type: "play";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
}

/**
 * Fade out everything that this client plays; requires the role "play".
 *
 * Its textures are silent until `Resume`. Its waveforms and effects are discarded.
 */
export interface StopPlaying {
  type: "stop";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
}

/** Scale everything that this client plays on a display; requires the role "play". */
export interface SetGain {
  type: "gain";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
  /** Factor of textures, waveforms and effects, 0 to 1. */
  gain: number;
}

/**
 * Time at which a waveform, an effect or tactile frames are to begin.
 *
 * It begins with the sample that is nearest to the time. What became of it, an `OnsetMessage`
 * reports, unless the answer was a failure.
 */
export interface BeginAt {
  /**
   * Time of the server's monotonic clock at which the first sample is to be put out, at most
   * 60 s ahead [µs].
   */
  at_us: number;
  /**
   * Whether it is dropped if that is not possible, because the time has passed or the contactors
   * still play a waveform of this client. If not, it begins as soon as possible.
   * @default false
   */
  drop_late?: boolean;
  /**
   * Number chosen by the client, which the `OnsetMessage` repeats.
   * @default 0
   */
  number?: number;
  /**
   * Code that the marker lines of the amplifier take with the first sample, for 10 ms, below 2
   * to the power of `DisplayDescription.marker_lines`; 0 for none.
   * @default 0
   */
  marker?: number;
}

/**
 * Queue a waveform of tangential shear; requires the role "play" and an armed display.
 *
 * It follows XR_FB_haptic_pcm: samples that do not fit in the client's buffer are not taken.
 * `AppendedReply` tells how many were taken; the client sends the rest again. Each contactor has a
 * queue of its own, and a waveform of several contactors begins on all of them at once, when the
 * last one is free.
 */
export interface Append {
  type: "append";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
  /** Rate of the samples [Hz]; the server resamples them to the rate of the display. */
  sample_rate_hz: number;
  /** Shear that a sample of 1 stands for [µm]. */
  amplitude_um: number;
  /**
   * Samples from −1 to 1, at most 4000: a list of numbers, or little-endian float32 as a binary
   * field of MessagePack (a base64 string in JSON).
   */
  samples: number[] | Uint8Array;
  /**
   * Whether to play the samples after those that are queued. If false, what is queued for the
   * same contactors is dropped first, even if none of the new samples is taken.
   * @default true
   */
  append?: boolean;
  /**
   * Indices of the contactors that play the waveform; all if the list is empty.
   * @default []
   */
  contactors?: number[];
  /**
   * Time at which it is to begin; null for as soon as the contactors are free. Of a waveform
   * that has a time, a second is taken, and what is appended without one does not wait for it.
   */
  begin?: BeginAt | null;
}

/**
 * Stream tactile frames; requires the role "play".
 *
 * A tactile frame is the shear of every contactor at one instant. It is not a request: it has no
 * `id`, and only frames that cannot be used are answered, by a `Failure`. Frames that come while
 * the display is not armed, after `StopPlaying`, or faster than they are played, are not played,
 * and are counted as `dropped_frames`. If a frame comes too late, the one before it is held,
 * which is counted as `frame_gaps`; if no frame comes any more, the stream fades out within a
 * tenth of a second. A client has one stream on a display: frames of another rate, or with
 * another `latest`, replace it.
 *
 * If the frames have times, they are played at a constant delay after their source made them,
 * however unevenly they come. A frame that comes after its time is dropped. Where the times of two
 * messages do not follow each other, to within 1 ms, the signal fades out and in.
 */
export interface TactileFrames {
  type: "frames";
  /** Name of the display. */
  display: string;
  /** Rate of the frames [Hz]. */
  frame_rate_hz: number;
  /** Shear that a value of 1 stands for [µm]. */
  amplitude_um: number;
  /**
   * Values from −1 to 1, frame by frame, each with one value for every contactor, at most 12 000
   * in all: a list of numbers, or little-endian float32 as a binary field of MessagePack (a
   * base64 string in JSON).
   */
  frames: number[] | Uint8Array;
  /**
   * Whether only the newest frame counts: the signal moves to it in a straight line, within the
   * period of the frames, as soon as it comes. If false, every frame is played, in a
   * band-limited signal (up to 0.32 of the rate), which follows the clock of the source. It is
   * four frames and 3 ms behind the frames as they come, more if the source is not even.
   * @default false
   */
  latest?: boolean;
  /**
   * Time at which the first of the frames is to be played, in a stream that replaces the one
   * before; null for frames that continue a stream: one of the same rate that waits for its
   * time, else the one that plays.
   */
  begin?: BeginAt | null;
  /**
   * Time of the server's monotonic clock at which the first of the frames is to be put out, at
   * most a second ahead, in a stream whose frames all have times; null for frames that are
   * played as they come [µs].
   */
  time_us?: number | null;
}

/** Amplitude at a time, an array [time_ms, value]; linear between points. */
export type Point = [
  /** Time since the beginning of the effect [ms]. */
  time_ms: number,
  /** Amplitude relative to the `amplitude_um` of the effect, 0 to 1. */
  value: number,
];

/** Frequency at a time, an array [time_ms, frequency_hz]; linear between points. */
export type FrequencyPoint = [
  /** Time since the beginning of the effect [ms]. */
  time_ms: number,
  /** Frequency [Hz]. */
  frequency_hz: number,
];

/** Tap at a time, an array [time_ms, value, frequency_hz]: two periods of a decaying sine. */
export type Transient = [
  /** Time since the beginning of the effect [ms]. */
  time_ms: number,
  /** Amplitude relative to the `amplitude_um` of the effect, 0 to 1. */
  value: number,
  /**
   * Frequency of the sine [Hz].
   * @default 160.0
   */
  frequency_hz?: number,
];

/**
 * Play an effect given by curves of amplitude and frequency over time.
 *
 * It requires the role "play" and an armed display, and follows XR_EXT_haptic_parametric. The
 * effect starts at once on all contactors, is added to the client's textures and waveforms, and
 * replaces an earlier effect of the client. It ends with its last point of amplitude or its last
 * transient. Times must not descend within a curve.
 */
export interface PlayEffect {
  type: "effect";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
  /** Shear that a value of 1 stands for [µm]. */
  amplitude_um: number;
  /**
   * Amplitude over time; without points, only the transients sound.
   * @default []
   */
  amplitude?: Point[];
  /**
   * Frequency over time; without points, it is 160 Hz.
   * @default []
   */
  frequency?: FrequencyPoint[];
  /**
   * Taps that are added, in any order.
   * @default []
   */
  transients?: Transient[];
  /**
   * Whether this is a frame of a stream. It then takes over from the frame before it, in place
   * of what was still to come of that, and its last amplitude is held for 50 ms before it fades.
   * @default false
   */
  stream?: boolean;
  /** Time at which it is to begin; null for at once. */
  begin?: BeginAt | null;
}

/** Ask for all effects that can be played by name; answered by `Effects`. */
export interface ListEffects {
  type: "list_effects";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
}

/**
 * Play an effect of the server; requires the role "play" and an armed display.
 *
 * It starts at once on all contactors, in place of the client's queued waveform, and is added to
 * everything else that plays.
 */
export interface PlayNamedEffect {
  type: "play_effect";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
  /** Name of an effect, as listed in `Effects`. */
  effect: string;
  /**
   * Factor of the effect's amplitude, 0 to 1.
   * @default 1.0
   */
  gain?: number;
  /** Time at which it is to begin; null for at once. */
  begin?: BeginAt | null;
}

/**
 * Switch high voltage on and start playing; requires the role "arm".
 *
 * Only do so if the person at the display knows of it. The client owns the high voltage from then
 * on.
 */
export interface ArmDisplay {
  type: "arm";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
}

/** Fade out and switch high voltage off, whoever armed; requires the role "arm" or "stop". */
export interface DisarmDisplay {
  type: "disarm";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
}

/**
 * Drive displays to 0 V at once and latch the e-stop until `ClearEstop`; requires no role.
 *
 * `Done` holds the number of the e-stop of each display.
 */
export interface EStop {
  type: "estop";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display; all displays if there is none. */
  display?: string | null;
}

/**
 * End an e-stop, after a person has decided that it is safe; requires the role "arm".
 *
 * The display is disarmed afterwards. If a newer e-stop holds, the answer is a `Failure` with the
 * code `estopped`.
 */
export interface ClearEstop {
  type: "clear";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
  /** Number of the e-stop, as in `Done`, `EventMessage`, `StatsReply` and `DisplayDescription`. */
  estop: number;
}

/**
 * Ask for a `TelemetryMessage` of a display at a regular rate.
 *
 * It replaces the client's earlier subscription to that display.
 */
export interface Subscribe {
  type: "subscribe";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
  /** Messages per second [Hz]; 0 ends the subscription. */
  rate_hz: number;
  /** Contactor whose commanded shear the messages hold sample by sample; null for none. */
  contactor?: number | null;
  /**
   * Whether the messages hold `TelemetrySamples` of all contactors; more messages come than
   * `rate_hz` says if these do not fit. The client then also gets an `OnsetMessage` for what
   * other clients play at a time.
   * @default false
   */
  samples?: boolean;
}

/** Ask for the state of a display; answered by `StatsReply`. */
export interface GetStats {
  type: "get_stats";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Name of the display. */
  display: string;
}

/** Ask for the server's time; answered by `Pong`. */
export interface Ping {
  type: "ping";
  /** Identifier chosen by the client, which the answer repeats. */
  id?: number | null;
  /** Time of the client, which `Pong` repeats [µs]. */
  time_us: number;
}

/** Properties of a display, and the state of its e-stop when the description was made. */
export interface DisplayDescription {
  /** Name of the display, as used in all requests. */
  name: string;
  /** Positions x, y of the contactors under the finger [mm]. */
  contactors_mm: [number, number][];
  /** Direction in which each contactor shears the skin, counterclockwise from x [°]. */
  shear_direction_deg: number[];
  /** Rate of the drive [Hz]. */
  sample_rate_hz: number;
  /** Limit of the drive [V]. */
  voltage_limit_v: number;
  /**
   * Whether the link carries samples. If false, `Append`, `PlayEffect` and `TactileFrames` are
   * unsupported.
   */
  waveforms: boolean;
  /** Approximate latency from a contact message to the skin [ms]. */
  latency_ms: number;
  /**
   * Number of the e-stop that holds, 0 if none does.
   * @default 0
   */
  estop?: number;
  /**
   * Number of the latest e-stop, cleared or not; 0 if there has been none.
   * @default 0
   */
  latest_estop?: number;
  /**
   * Whether playback follows the finger, so that `TelemetryMessage` has the loads that it finds.
   * @default false
   */
  follows?: boolean;
  /**
   * Pairs of a frequency [Hz] and the peak of a shear of that frequency that is just felt [µm],
   * in third octaves; linear between them in the logarithms.
   * @default []
   */
  threshold_um?: [number, number][];
  /**
   * Number of marker lines of its amplifier; 0 for none.
   * @default 0
   */
  marker_lines?: number;
}

/** Answer to `ClientHello`: the client is admitted. */
export interface Welcome {
  type: "welcome";
  /** Identifier of the request that is answered. */
  id?: number | null;
  /** Name and version of the server. */
  server: string;
  /** Version of the API. */
  version: number;
  /** Identifier of this connection in the server's log. */
  session: string;
  /** Displays of the server. */
  displays: DisplayDescription[];
  /** Whether the client has the role "arm". */
  may_arm: boolean;
  /** Time of the server's monotonic clock [µs]. */
  time_us: number;
  /**
   * Roles of the client.
   * @default []
   */
  roles?: Role[];
  /**
   * Largest message that the server accepts [bytes].
   * @default 65536
   */
  largest_message?: number;
  /**
   * Maximum rate of messages of this client [1/s]; 0 if it is not limited.
   * @default 0
   */
  messages_per_second?: number;
}

/** Description of a texture that can be selected. */
export interface TextureInfo {
  /** Name that `Select` takes. */
  name: string;
  /** Category, such as "wood". */
  category: string;
  /** Description for people. */
  description: string;
  /** Source of the texture's parameters. */
  provenance: string;
}

/** Answer to `ListTextures`. */
export interface Textures {
  type: "textures";
  /** Identifier of the request that is answered. */
  id?: number | null;
  /** All textures of the server. */
  textures: TextureInfo[];
}

/** Answer to `DrawTexture`: displacement of the surface in 256 steps. */
export interface TexturePicture {
  type: "texture_picture";
  /** Identifier of the request that is answered. */
  id?: number | null;
  /** Displacement that the value 0 stands for, at the texture's reference speed and force [µm]. */
  lowest_um: number;
  /** Displacement that the value 255 stands for [µm]. */
  highest_um: number;
  /**
   * Displacement of each pixel, row by row from the largest y (a base64 string in JSON). Half a
   * percent of the pixels is clipped at either end.
   */
  pixels: Uint8Array;
}

/** Description of an effect that can be played by name. */
export interface EffectInfo {
  /** Name that `PlayNamedEffect` takes. */
  name: string;
  /** Description for people. */
  description: string;
  /** Duration [s]. */
  seconds: number;
}

/** Answer to `ListEffects`. */
export interface Effects {
  type: "effects";
  /** Identifier of the request that is answered. */
  id?: number | null;
  /** All effects of the server. */
  effects: EffectInfo[];
}

/** Answer to a request that was carried out and has no reply of its own. */
export interface Done {
  type: "done";
  /** Identifier of the request that is answered. */
  id?: number | null;
  /**
   * After an `EStop`, the number of the e-stop that was latched, by name of the display.
   * @default {}
   */
  estops?: Record<string, number>;
}

/** Answer to `Append`. */
export interface AppendedReply {
  type: "appended";
  /** Identifier of the request that is answered. */
  id?: number | null;
  /** Number of samples that were taken, counted from the first. */
  samples_consumed: number;
  /** Playing time of what is queued for these contactors of this client [ms]. */
  buffered_ms: number;
}

/** Answer to `Ping`. */
export interface Pong {
  type: "pong";
  /** Identifier of the request that is answered. */
  id?: number | null;
  /** Time in the `Ping` [µs]. */
  time_us: number;
  /** Time of the server's monotonic clock when the `Ping` arrived [µs]. */
  server_time_us: number;
}

/** Answer to `GetStats`: the state of a display. */
export interface StatsReply {
  type: "stats";
  /** Identifier of the request that is answered. */
  id?: number | null;
  /** Name of the display. */
  display: string;
  /**
   * "disarmed", "armed", "estopped" or "lost". "lost" means that the playback process died and
   * is being restarted.
   */
  state: "armed" | "disarmed" | "estopped" | "lost";
  /** "up" or "down". */
  link: "down" | "up";
  /** Reason of a failure or of the e-stop in one line; otherwise the status of the device. */
  detail: string;
  /** Whether a finger touches the display. */
  touching: boolean;
  /** Whether the finger belongs to this client. */
  owner: boolean;
  /**
   * Present latency from the arrival of a contact message to the skin: the lead, what the link
   * adds and half a block, whether or not a finger touches; null while nothing plays [ms].
   */
  latency_ms: number | null;
  /** Counters of the device's bus and of playback since it started, by name. */
  counters: Record<string, number>;
  /**
   * Number of the e-stop that holds, 0 if none does.
   * @default 0
   */
  estop?: number;
  /**
   * Share that was put out of what was due since the display was armed, from 0 to 1, as far as
   * its amplifiers have reported; null if nothing was due.
   */
  put_out_share?: number | null;
  /**
   * Time by which drive is sent before it is put out, the part of the latency that bridges
   * delays of the link [ms]; null as long as the device is not open.
   */
  lead_ms?: number | null;
}

/**
 * Answer to a message that could not be carried out.
 *
 * Codes: "malformed" (the message cannot be decoded), "too_large", "unknown_type",
 * "invalid_field", "unknown_texture", "unknown_effect", "unknown_display", "wrong_version",
 * "unauthorized" (wrong token, or a role is missing), "hello_first" (`ClientHello` is missing),
 * "too_many_clients", "too_fast" (messages were dropped because there were too many per second),
 * "not_armed", "estopped" (an e-stop holds), "busy" (too many requests or textures of this client
 * are pending), "unavailable" (the display, its device or a texture cannot be used now),
 * "unsupported" and "internal" (a fault of the server).
 */
export interface Failure {
  type: "failure";
  /** Identifier of the request that is answered. */
  id?: number | null;
  /** Kind of the failure, one of those above. */
  code: Code;
  /** Explanation in one line. */
  message: string;
  /**
   * Path of the offending field in the message, such as "layers[0].texture"; empty if no field
   * is to blame.
   * @default ""
   */
  field?: string;
}

/**
 * Event on a display, sent to all clients without a request.
 *
 * Kinds are "armed", "disarmed", "estopped", "cleared" (an e-stop was cleared), "fault",
 * "underrun", "link" (the link went up or down), "silent" (this client gave no sign of life and
 * its waveforms were faded), "lost" (playback died and is being restarted) and "textures" (the
 * textures were read again). Clients that have subscribed to the telemetry of a display that
 * follows the finger also get "touched" and "lifted" (a finger is on contactors now, or not any
 * more). Other kinds may be added.
 */
export interface EventMessage {
  type: "event";
  /** Name of the display. */
  display: string;
  /** Kind of the event. */
  kind: string;
  /**
   * Explanation in one line.
   * @default ""
   */
  detail?: string;
  /**
   * Number of the e-stop that an "estopped" or "cleared" event is about, otherwise 0.
   * @default 0
   */
  estop?: number;
  /**
   * Contactors that a "touched" or "lifted" event is about, in ascending order.
   * @default []
   */
  contactors?: number[];
}

/**
 * Report on a waveform, an effect or tactile frames that were to begin at a time.
 *
 * It comes a third of a second after that, when the amplifier has reported what it put out.
 */
export interface OnsetMessage {
  type: "onset";
  /** Name of the display. */
  display: string;
  /** Number that the client gave it in `BeginAt`. */
  number: number;
  /** Time at which it was to begin, as in `BeginAt` [µs]. */
  at_us: number;
  /**
   * Time of the server's monotonic clock at which its first sample was put out, by the clock of
   * the amplifier; null if it was not [µs].
   */
  onset_us: number | null;
  /**
   * Half of the interval around `onset_us` that holds the true time; null if it is not known,
   * as on a sound card [µs].
   */
  uncertainty_us: number | null;
  /**
   * Reason in one line why it did not begin, or not at its time, or without its marker; empty if
   * all was as it should be.
   * @default ""
   */
  reason?: string;
  /**
   * Code that the marker lines have shown with its first sample, as far as the amplifier has
   * confirmed that; 0 for none.
   * @default 0
   */
  marker?: number;
  /** Number of the client that plays it; null if it is the client that gets this message. */
  client?: number | null;
}

/** Loads of a finger on the contactors, as playback finds them from their currents. */
export interface TelemetryFinger {
  /** Whether a finger is on each contactor. */
  touching: boolean[];
  /**
   * Magnitude of the dynamic stiffness of the load on each contactor at 100 Hz; 0 in air [N/m].
   */
  stiffness_n_m: number[];
  /**
   * Standard deviation of the level of each contactor's shear that follows from the uncertainty
   * of its load; 0 in air [dB].
   */
  equalizer_error_db: number[];
  /**
   * Whether a load explains the current of each contactor. Where none does, filters for a mean
   * finger play.
   */
  explained: boolean[];
  /**
   * Whether the guard of an amplifier has turned each contactor down, because it lost the
   * finger. It comes back as soon as what plays is harmless to a bender in air.
   */
  guarded: boolean[];
}

/** Shear of one contactor, sample by sample. */
export interface TelemetryTrace {
  /** Index of the contactor. */
  contactor: number;
  /** Rate of the samples [Hz]. */
  sample_rate_hz: number;
  /**
   * Number of the first sample. It continues the message before unless samples are missing, and
   * begins anew when playback is started again.
   */
  first: number;
  /**
   * Samples since the message before as little-endian float32, none while nothing plays [µm]; a
   * binary field of MessagePack (a base64 string in JSON).
   */
  shear_um: Uint8Array;
}

/**
 * What playback has handed to the amplifier since the message before, sample by sample.
 *
 * Binary fields are little-endian, and binary fields of MessagePack (base64 strings in JSON). Rows
 * of samples hold a value for each contactor. All is as commanded: after an e-stop, the amplifier
 * turns to 0 V by itself.
 */
export interface TelemetrySamples {
  /**
   * Number of the first sample. It continues the message before unless samples are missing, and
   * begins anew when the server opens the display anew.
   */
  first: number;
  /** Nominal rate of the samples [Hz]. */
  sample_rate_hz: number;
  /** Number of samples of a block. */
  block_samples: number;
  /**
   * Time of the server's monotonic clock at which the first sample of each block is put out, by
   * the clock of the amplifier, as float64 [µs]. Blocks are handed over before that.
   */
  times_us: Uint8Array;
  /**
   * Half of the largest interval around these times that holds the true one; null if it is not
   * known, as on a sound card [µs].
   */
  uncertainty_us: number | null;
  /** Time of the server's monotonic clock for which each block has the finger, as float64 [µs]. */
  finger_times_us: Uint8Array;
  /** Position of the finger in each block, as pairs of float32 [mm]. */
  position_mm: Uint8Array;
  /** Velocity of the finger in each block, as pairs of float32 [mm/s]. */
  velocity_mm_s: Uint8Array;
  /** Normal force of the finger in each block, as float32 [N]. */
  normal_force_n: Uint8Array;
  /** Whether the finger touches the surface in each block. */
  touching: boolean[];
  /**
   * Rows of commanded shear as float32, in step with the drive [µm]; null on a link that takes
   * spectrum frames.
   */
  shear_um: Uint8Array | null;
  /** Rows of drive as float32 [V]; null on a link that takes spectrum frames. */
  drive_v: Uint8Array | null;
}

/** State of a display at one instant, sent at the rate that `Subscribe` asked for. */
export interface TelemetryMessage {
  type: "telemetry";
  /** Name of the display. */
  display: string;
  /** Time of the server's monotonic clock [µs]. */
  time_us: number;
  /** State as in `StatsReply`. */
  state: string;
  /** Position of the finger on the surface, as playback tracks it [mm]. */
  position_mm: [number, number];
  /** Velocity of the finger [mm/s]. */
  velocity_mm_s: [number, number];
  /** Normal force of the finger [N]. */
  normal_force_n: number;
  /**
   * Commanded shear of each contactor, 0 while nothing plays [µm]; null on a link that takes
   * spectrum frames, for which it is not computed.
   */
  shear_um: number[] | null;
  /** Drive of each contactor, 0 while nothing plays [V]. */
  drive_v: number[];
  /** Counters as in `StatsReply`. */
  counters: Record<string, number>;
  /** Share that was put out, as in `StatsReply`. */
  put_out_share?: number | null;
  /** Loads of the finger on a display that follows it; null where they are not known. */
  finger?: TelemetryFinger | null;
  /**
   * Commanded shear of the contactor that `Subscribe` named; null without one, and on a link
   * that takes spectrum frames.
   */
  trace?: TelemetryTrace | null;
  /**
   * Shear of the skin at that contactor on a simulated display, which alone knows it. Its
   * samples are later than those of `trace`, and have numbers of their own.
   */
  played?: TelemetryTrace | null;
  /** What was handed to the amplifier since the message before, if `Subscribe` asked for it. */
  samples?: TelemetrySamples | null;
}

/** Any message of a client. */
export type Command =
  | ClientHello
  | ListTextures
  | DrawTexture
  | Select
  | Contact
  | Resume
  | StopPlaying
  | SetGain
  | Append
  | TactileFrames
  | PlayEffect
  | ListEffects
  | PlayNamedEffect
  | ArmDisplay
  | DisarmDisplay
  | EStop
  | ClearEstop
  | Subscribe
  | GetStats
  | Ping;

/** Any message of the server. */
export type Answer =
  | Welcome
  | Textures
  | TexturePicture
  | Effects
  | Done
  | AppendedReply
  | Pong
  | StatsReply
  | Failure
  | EventMessage
  | OnsetMessage
  | TelemetryMessage;
