/**
 * Messages of `tactile serve` in C99 and C++: structures, and their encoding as MessagePack.
 *
 * This file is written by `python -m clients.generate` from the JSON Schema of the API and from
 * tactile_client.h.in. Everything is in this one header. There is no global state, and nothing is
 * allocated.
 *
 * The connection is not part of it. Open a WebSocket at TACTILE_PATH with the subprotocol
 * TACTILE_MSGPACK_PROTOCOL by a library such as libwebsockets or IXWebSocket, send what
 * `tactile_encode_...` writes as one binary message each, and pass each message that arrives to
 * `tactile_decode`.
 *
 * Set a message to zero (`= {0}`), then its fields. A field that is zero or empty is left out where
 * that is its default. Any other field that may be absent has a flag `has_...`: it is sent if the
 * flag is set. `tactile_decode` fills in the defaults of absent fields; a field without a default
 * is valid only if its flag is set.
 *
 * Texts and binary fields point to bytes of the program, or to those that were decoded. They do not
 * end with a zero. Texts are UTF-8, which is not checked. Lists and maps point to arrays.
 *
 * Comments name a message by its class in tactile/messages.py, such as `EventMessage`. Here it is
 * named by its type, such as `tactile_event`; what is no message is named by its class, such as
 * `tactile_effect_info` for `EffectInfo`.
 */
#ifndef TACTILE_CLIENT_H
#define TACTILE_CLIENT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* Constants */

/** Version of the API that `ClientHello` and `Welcome` carry. */
#define TACTILE_API_VERSION 1

/** WebSocket subprotocol of messages in MessagePack. */
#define TACTILE_MSGPACK_PROTOCOL "tactile.v1.msgpack"

/** Path of the WebSocket in the server's URL. */
#define TACTILE_PATH "/v1"

/** Largest size of a message [bytes]. */
#define TACTILE_LARGEST_MESSAGE 65536

/** Maximum number of textures that one client may select on one display at a time. */
#define TACTILE_MOST_LAYERS 4

/**
 * Maximum number of samples of a waveform in one message, as in XR_FB_haptic_pcm
 * (XR_MAX_HAPTIC_PCM_BUFFER_SIZE_FB).
 */
#define TACTILE_MOST_SAMPLES 4000

/**
 * Maximum number of points of each curve of a parametric effect in one message, as in
 * XR_EXT_haptic_parametric.
 */
#define TACTILE_MOST_POINTS 500

/** Time without a contact after which a touching client is taken to have lifted its finger [s]. */
#define TACTILE_SILENCE 0.1

/* Parts of messages */

/** Text of UTF-8 without a zero at its end. */
typedef struct {
  const char *data;
  size_t size;
} tactile_text;

/** Binary data. */
typedef struct {
  const uint8_t *data;
  size_t size;
} tactile_bytes;

/** Pair of numbers, such as x and y. */
typedef struct {
  double first;
  double second;
} tactile_pair;

/** Make a text of a string that ends with a zero. */
static inline tactile_text tactile_text_of(const char *string) {
  tactile_text text;
  text.data = string;
  text.size = strlen(string);
  return text;
}

/** Return whether a text is the same as a string that ends with a zero. */
static inline bool tactile_text_is(tactile_text text, const char *string) {
  return text.size == strlen(string) && (text.size == 0 || !memcmp(text.data, string, text.size));
}

/* Enumerations and structures */

/** Permission of a client; the module docstring says what each role allows. */
typedef enum {
  TACTILE_ROLE_UNKNOWN,
  TACTILE_ROLE_WATCH,
  TACTILE_ROLE_PLAY,
  TACTILE_ROLE_ARM,
  TACTILE_ROLE_STOP
} tactile_role;

static const char *const tactile_names_role[] = {
    "",
    "watch",
    "play",
    "arm",
    "stop",
    NULL};

/** Return the text of a value; empty if it is unknown. */
static inline const char *tactile_role_name(tactile_role value) {
  return tactile_names_role[value];
}

/** Kind of a `Failure`. */
typedef enum {
  TACTILE_CODE_UNKNOWN,
  TACTILE_CODE_MALFORMED,
  TACTILE_CODE_TOO_LARGE,
  TACTILE_CODE_UNKNOWN_TYPE,
  TACTILE_CODE_INVALID_FIELD,
  TACTILE_CODE_UNKNOWN_TEXTURE,
  TACTILE_CODE_UNKNOWN_EFFECT,
  TACTILE_CODE_UNKNOWN_DISPLAY,
  TACTILE_CODE_WRONG_VERSION,
  TACTILE_CODE_UNAUTHORIZED,
  TACTILE_CODE_HELLO_FIRST,
  TACTILE_CODE_TOO_MANY_CLIENTS,
  TACTILE_CODE_TOO_FAST,
  TACTILE_CODE_NOT_ARMED,
  TACTILE_CODE_ESTOPPED,
  TACTILE_CODE_BUSY,
  TACTILE_CODE_UNAVAILABLE,
  TACTILE_CODE_UNSUPPORTED,
  TACTILE_CODE_INTERNAL
} tactile_code;

static const char *const tactile_names_code[] = {
    "",
    "malformed",
    "too_large",
    "unknown_type",
    "invalid_field",
    "unknown_texture",
    "unknown_effect",
    "unknown_display",
    "wrong_version",
    "unauthorized",
    "hello_first",
    "too_many_clients",
    "too_fast",
    "not_armed",
    "estopped",
    "busy",
    "unavailable",
    "unsupported",
    "internal",
    NULL};

/** Return the text of a value; empty if it is unknown. */
static inline const char *tactile_code_name(tactile_code value) {
  return tactile_names_code[value];
}

/** Value of `state` of `tactile_stats`. */
typedef enum {
  TACTILE_STATS_STATE_UNKNOWN,
  TACTILE_STATS_STATE_ARMED,
  TACTILE_STATS_STATE_DISARMED,
  TACTILE_STATS_STATE_ESTOPPED,
  TACTILE_STATS_STATE_LOST
} tactile_stats_state;

static const char *const tactile_names_stats_state[] = {
    "",
    "armed",
    "disarmed",
    "estopped",
    "lost",
    NULL};

/** Return the text of a value; empty if it is unknown. */
static inline const char *tactile_stats_state_name(tactile_stats_state value) {
  return tactile_names_stats_state[value];
}

/** Value of `link` of `tactile_stats`. */
typedef enum {
  TACTILE_STATS_LINK_UNKNOWN,
  TACTILE_STATS_LINK_DOWN,
  TACTILE_STATS_LINK_UP
} tactile_stats_link;

static const char *const tactile_names_stats_link[] = {
    "",
    "down",
    "up",
    NULL};

/** Return the text of a value; empty if it is unknown. */
static inline const char *tactile_stats_link_name(tactile_stats_link value) {
  return tactile_names_stats_link[value];
}

/** Type of a message of the server. */
typedef enum {
  TACTILE_TYPE_UNKNOWN,
  TACTILE_TYPE_WELCOME,
  TACTILE_TYPE_TEXTURES,
  TACTILE_TYPE_TEXTURE_PICTURE,
  TACTILE_TYPE_EFFECTS,
  TACTILE_TYPE_DONE,
  TACTILE_TYPE_APPENDED,
  TACTILE_TYPE_PONG,
  TACTILE_TYPE_STATS,
  TACTILE_TYPE_FAILURE,
  TACTILE_TYPE_EVENT,
  TACTILE_TYPE_ONSET,
  TACTILE_TYPE_TELEMETRY
} tactile_type;

static const char *const tactile_names_type[] = {
    "",
    "welcome",
    "textures",
    "texture_picture",
    "effects",
    "done",
    "appended",
    "pong",
    "stats",
    "failure",
    "event",
    "onset",
    "telemetry",
    NULL};

/** Return the text of a value; empty if it is unknown. */
static inline const char *tactile_type_name(tactile_type value) {
  return tactile_names_type[value];
}

/**
 * First message of a client: its name, the API version that it speaks, and its token.
 *
 * It is answered by `Welcome`, or by a `Failure` after which the server closes the connection.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the program, for logs and for the reason of an e-stop. */
  tactile_text client;
  /**
   * Version of the API that the client speaks.
   * Default: 1.
   */
  bool has_version;
  int64_t version;
  /**
   * Token that the server's configuration knows; it determines the roles of the client. Empty if
   * the client has none.
   */
  tactile_text token;
} tactile_hello;

/** Ask for all textures that can be selected; answered by `Textures`. */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
} tactile_list_textures;

/**
 * Ask for a picture of a texture's surface; answered by `TexturePicture`.
 *
 * A picture may take a second. It does not delay other requests of the client, so that answers may
 * come in another order, and it waits for textures that are being prepared.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of a texture, as listed in `Textures`. */
  tactile_text texture;
  /** Seed of the random realization, as in `Layer`. */
  int64_t seed;
  /** Coordinate x of the left edge of the picture [mm]. */
  double left_mm;
  /** Coordinate y of the lower edge [mm]. */
  double bottom_mm;
  /** Side of a pixel [mm]; a pixel is the mean over its area. */
  double pixel_mm;
  /** Number of pixels along x. */
  int64_t columns;
  /** Number of pixels along y; with the columns at most 262 144 pixels in all. */
  int64_t rows;
} tactile_draw_texture;

/** One of the textures that a client superimposes. */
typedef struct {
  /** Name of a texture, as listed in `Textures`. */
  tactile_text texture;
  /**
   * Factor of the texture's amplitude, 0 to 1. What 1 is, the key `levels` of the server's
   * configuration says: by default the largest that the limits of the display leave unchanged.
   * Default: 1.0.
   */
  bool has_gain;
  double gain;
  /** Seed of the random realization of the texture; the same seed gives the same surface. */
  int64_t seed;
} tactile_layer;

/** List of `tactile_layer`. */
typedef struct {
  const tactile_layer *items;
  size_t count;
} tactile_layer_list;

/**
 * Select the textures that the finger feels of this client; requires the role "play".
 *
 * They replace the client's earlier selection in a cross-fade. `Done` follows once the textures
 * are ready; preparing one may take a second.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
  /** Textures to superimpose; an empty list deselects all. */
  tactile_layer_list layers;
} tactile_select;

/**
 * Report where the finger is and how hard it presses; requires the role "play".
 *
 * It is not a request: it has no `id`, and only a contact that cannot be used is answered, by a
 * `Failure`. Send one per frame.
 */
typedef struct {
  /** Name of the display. */
  tactile_text display;
  /** Position x, y of the finger on the surface [mm]. */
  tactile_pair position_mm;
  /** Normal force [N]; 0 lifts the finger. */
  double normal_force_n;
  /**
   * Time at which the finger was there, on the client's monotonic clock [µs]. Without it, the
   * time of arrival is used.
   */
  bool has_time_us;
  int64_t time_us;
  /**
   * Velocity of the finger [mm/s]. If it is given, it is used to predict the next milliseconds,
   * which is more accurate than a prediction from positions alone.
   */
  bool has_velocity_mm_s;
  tactile_pair velocity_mm_s;
} tactile_contact;

/**
 * Resume this client's textures after `StopPlaying`; requires the role "play".
 *
 * The textures of a new client sound without it.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
} tactile_play;

/**
 * Fade out everything that this client plays; requires the role "play".
 *
 * Its textures are silent until `Resume`. Its waveforms and effects are discarded.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
} tactile_stop;

/** Scale everything that this client plays on a display; requires the role "play". */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
  /** Factor of textures, waveforms and effects, 0 to 1. */
  double gain;
} tactile_gain;

/** List of `double`. */
typedef struct {
  const double *items;
  size_t count;
} tactile_number_list;

/** List of `int64_t`. */
typedef struct {
  const int64_t *items;
  size_t count;
} tactile_integer_list;

/**
 * Time at which a waveform, an effect or tactile frames are to begin.
 *
 * It begins with the sample that is nearest to the time. What became of it, an `OnsetMessage`
 * reports, unless the answer was a failure.
 */
typedef struct {
  /**
   * Time of the server's monotonic clock at which the first sample is to be put out, at most
   * 60 s ahead [µs].
   */
  int64_t at_us;
  /**
   * Whether it is dropped if that is not possible, because the time has passed or the contactors
   * still play a waveform of this client. If not, it begins as soon as possible.
   */
  bool drop_late;
  /** Number chosen by the client, which the `OnsetMessage` repeats. */
  int64_t number;
  /**
   * Code that the marker lines of the amplifier take with the first sample, for 10 ms, below 2
   * to the power of `DisplayDescription.marker_lines`; 0 for none.
   */
  int64_t marker;
} tactile_begin_at;

/**
 * Queue a waveform of tangential shear; requires the role "play" and an armed display.
 *
 * It follows XR_FB_haptic_pcm: samples that do not fit in the client's buffer are not taken.
 * `AppendedReply` tells how many were taken; the client sends the rest again. Each contactor has a
 * queue of its own, and a waveform of several contactors begins on all of them at once, when the
 * last one is free.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
  /** Rate of the samples [Hz]; the server resamples them to the rate of the display. */
  double sample_rate_hz;
  /** Shear that a sample of 1 stands for [µm]. */
  double amplitude_um;
  /**
   * Samples from −1 to 1, at most 4000: a list of numbers, or little-endian float32 as a binary
   * field of MessagePack (a base64 string in JSON).
   */
  tactile_number_list samples;
  /** Alternative to `samples`, which is used if the flag is set. */
  bool has_samples_bytes;
  tactile_bytes samples_bytes;
  /**
   * Whether to play the samples after those that are queued. If false, what is queued for the
   * same contactors is dropped first, even if none of the new samples is taken.
   * Default: true.
   */
  bool has_append;
  bool append;
  /** Indices of the contactors that play the waveform; all if the list is empty. */
  tactile_integer_list contactors;
  /**
   * Time at which it is to begin; null for as soon as the contactors are free. Of a waveform
   * that has a time, a second is taken, and what is appended without one does not wait for it.
   */
  bool has_begin;
  tactile_begin_at begin;
} tactile_append;

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
typedef struct {
  /** Name of the display. */
  tactile_text display;
  /** Rate of the frames [Hz]. */
  double frame_rate_hz;
  /** Shear that a value of 1 stands for [µm]. */
  double amplitude_um;
  /**
   * Values from −1 to 1, frame by frame, each with one value for every contactor, at most 12 000
   * in all: a list of numbers, or little-endian float32 as a binary field of MessagePack (a
   * base64 string in JSON).
   */
  tactile_number_list frames;
  /** Alternative to `frames`, which is used if the flag is set. */
  bool has_frames_bytes;
  tactile_bytes frames_bytes;
  /**
   * Whether only the newest frame counts: the signal moves to it in a straight line, within the
   * period of the frames, as soon as it comes. If false, every frame is played, in a
   * band-limited signal (up to 0.32 of the rate), which follows the clock of the source. It is
   * four frames and 3 ms behind the frames as they come, more if the source is not even.
   */
  bool latest;
  /**
   * Time at which the first of the frames is to be played, in a stream that replaces the one
   * before; null for frames that continue a stream: one of the same rate that waits for its
   * time, else the one that plays.
   */
  bool has_begin;
  tactile_begin_at begin;
  /**
   * Time of the server's monotonic clock at which the first of the frames is to be put out, at
   * most a second ahead, in a stream whose frames all have times; null for frames that are
   * played as they come [µs].
   */
  bool has_time_us;
  int64_t time_us;
} tactile_frames;

/** Amplitude at a time, an array [time_ms, value]; linear between points. */
typedef struct {
  /** Time since the beginning of the effect [ms]. */
  double time_ms;
  /** Amplitude relative to the `amplitude_um` of the effect, 0 to 1. */
  double value;
} tactile_point;

/** List of `tactile_point`. */
typedef struct {
  const tactile_point *items;
  size_t count;
} tactile_point_list;

/** Frequency at a time, an array [time_ms, frequency_hz]; linear between points. */
typedef struct {
  /** Time since the beginning of the effect [ms]. */
  double time_ms;
  /** Frequency [Hz]. */
  double frequency_hz;
} tactile_frequency_point;

/** List of `tactile_frequency_point`. */
typedef struct {
  const tactile_frequency_point *items;
  size_t count;
} tactile_frequency_point_list;

/** Tap at a time, an array [time_ms, value, frequency_hz]: two periods of a decaying sine. */
typedef struct {
  /** Time since the beginning of the effect [ms]. */
  double time_ms;
  /** Amplitude relative to the `amplitude_um` of the effect, 0 to 1. */
  double value;
  /**
   * Frequency of the sine [Hz].
   * Default: 160.0.
   */
  bool has_frequency_hz;
  double frequency_hz;
} tactile_transient;

/** List of `tactile_transient`. */
typedef struct {
  const tactile_transient *items;
  size_t count;
} tactile_transient_list;

/**
 * Play an effect given by curves of amplitude and frequency over time.
 *
 * It requires the role "play" and an armed display, and follows XR_EXT_haptic_parametric. The
 * effect starts at once on all contactors, is added to the client's textures and waveforms, and
 * replaces an earlier effect of the client. It ends with its last point of amplitude or its last
 * transient. Times must not descend within a curve.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
  /** Shear that a value of 1 stands for [µm]. */
  double amplitude_um;
  /** Amplitude over time; without points, only the transients sound. */
  tactile_point_list amplitude;
  /** Frequency over time; without points, it is 160 Hz. */
  tactile_frequency_point_list frequency;
  /** Taps that are added, in any order. */
  tactile_transient_list transients;
  /**
   * Whether this is a frame of a stream. It then takes over from the frame before it, in place
   * of what was still to come of that, and its last amplitude is held for 50 ms before it fades.
   */
  bool stream;
  /** Time at which it is to begin; null for at once. */
  bool has_begin;
  tactile_begin_at begin;
} tactile_effect;

/** Ask for all effects that can be played by name; answered by `Effects`. */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
} tactile_list_effects;

/**
 * Play an effect of the server; requires the role "play" and an armed display.
 *
 * It starts at once on all contactors, in place of the client's queued waveform, and is added to
 * everything else that plays.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
  /** Name of an effect, as listed in `Effects`. */
  tactile_text effect;
  /**
   * Factor of the effect's amplitude, 0 to 1.
   * Default: 1.0.
   */
  bool has_gain;
  double gain;
  /** Time at which it is to begin; null for at once. */
  bool has_begin;
  tactile_begin_at begin;
} tactile_play_effect;

/**
 * Switch high voltage on and start playing; requires the role "arm".
 *
 * Only do so if the person at the display knows of it. The client owns the high voltage from then
 * on.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
} tactile_arm;

/** Fade out and switch high voltage off, whoever armed; requires the role "arm" or "stop". */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
} tactile_disarm;

/**
 * Drive displays to 0 V at once and latch the e-stop until `ClearEstop`; requires no role.
 *
 * `Done` holds the number of the e-stop of each display.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display; all displays if there is none. */
  bool has_display;
  tactile_text display;
} tactile_estop;

/**
 * End an e-stop, after a person has decided that it is safe; requires the role "arm".
 *
 * The display is disarmed afterwards. If a newer e-stop holds, the answer is a `Failure` with the
 * code `estopped`.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
  /** Number of the e-stop, as in `Done`, `EventMessage`, `StatsReply` and `DisplayDescription`. */
  int64_t estop;
} tactile_clear;

/**
 * Ask for a `TelemetryMessage` of a display at a regular rate.
 *
 * It replaces the client's earlier subscription to that display.
 */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
  /** Messages per second [Hz]; 0 ends the subscription. */
  double rate_hz;
  /** Contactor whose commanded shear the messages hold sample by sample; null for none. */
  bool has_contactor;
  int64_t contactor;
  /**
   * Whether the messages hold `TelemetrySamples` of all contactors; more messages come than
   * `rate_hz` says if these do not fit. The client then also gets an `OnsetMessage` for what
   * other clients play at a time.
   */
  bool samples;
} tactile_subscribe;

/** Ask for the state of a display; answered by `StatsReply`. */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
} tactile_get_stats;

/** Ask for the server's time; answered by `Pong`. */
typedef struct {
  /** Identifier chosen by the client, which the answer repeats. */
  bool has_id;
  int64_t id;
  /** Time of the client, which `Pong` repeats [µs]. */
  int64_t time_us;
} tactile_ping;

/** List of `tactile_pair`. */
typedef struct {
  const tactile_pair *items;
  size_t count;
} tactile_pair_list;

/** Properties of a display, and the state of its e-stop when the description was made. */
typedef struct {
  /** Name of the display, as used in all requests. */
  tactile_text name;
  /** Positions x, y of the contactors under the finger [mm]. */
  tactile_pair_list contactors_mm;
  /** Direction in which each contactor shears the skin, counterclockwise from x [°]. */
  tactile_number_list shear_direction_deg;
  /** Rate of the drive [Hz]. */
  double sample_rate_hz;
  /** Limit of the drive [V]. */
  double voltage_limit_v;
  /**
   * Whether the link carries samples. If false, `Append`, `PlayEffect` and `TactileFrames` are
   * unsupported.
   */
  bool waveforms;
  /** Approximate latency from a contact message to the skin [ms]. */
  double latency_ms;
  /** Number of the e-stop that holds, 0 if none does. */
  int64_t estop;
  /** Number of the latest e-stop, cleared or not; 0 if there has been none. */
  int64_t latest_estop;
  /**
   * Whether playback follows the finger, so that `TelemetryMessage` has the loads that it finds.
   */
  bool follows;
  /**
   * Pairs of a frequency [Hz] and the peak of a shear of that frequency that is just felt [µm],
   * in third octaves; linear between them in the logarithms.
   */
  tactile_pair_list threshold_um;
  /** Number of marker lines of its amplifier; 0 for none. */
  int64_t marker_lines;
} tactile_display_description;

/** List of `tactile_display_description`. */
typedef struct {
  const tactile_display_description *items;
  size_t count;
} tactile_display_description_list;

/** List of `tactile_role`. */
typedef struct {
  const tactile_role *items;
  size_t count;
} tactile_role_list;

/** Answer to `ClientHello`: the client is admitted. */
typedef struct {
  /** Identifier of the request that is answered. */
  bool has_id;
  int64_t id;
  /** Name and version of the server. */
  tactile_text server;
  /** Version of the API. */
  int64_t version;
  /** Identifier of this connection in the server's log. */
  tactile_text session;
  /** Displays of the server. */
  tactile_display_description_list displays;
  /** Whether the client has the role "arm". */
  bool may_arm;
  /** Time of the server's monotonic clock [µs]. */
  int64_t time_us;
  /** Roles of the client. */
  tactile_role_list roles;
  /**
   * Largest message that the server accepts [bytes].
   * Default: 65536.
   */
  bool has_largest_message;
  int64_t largest_message;
  /** Maximum rate of messages of this client [1/s]; 0 if it is not limited. */
  int64_t messages_per_second;
} tactile_welcome;

/** Description of a texture that can be selected. */
typedef struct {
  /** Name that `Select` takes. */
  tactile_text name;
  /** Category, such as "wood". */
  tactile_text category;
  /** Description for people. */
  tactile_text description;
  /** Source of the texture's parameters. */
  tactile_text provenance;
} tactile_texture_info;

/** List of `tactile_texture_info`. */
typedef struct {
  const tactile_texture_info *items;
  size_t count;
} tactile_texture_info_list;

/** Answer to `ListTextures`. */
typedef struct {
  /** Identifier of the request that is answered. */
  bool has_id;
  int64_t id;
  /** All textures of the server. */
  tactile_texture_info_list textures;
} tactile_textures;

/** Answer to `DrawTexture`: displacement of the surface in 256 steps. */
typedef struct {
  /** Identifier of the request that is answered. */
  bool has_id;
  int64_t id;
  /** Displacement that the value 0 stands for, at the texture's reference speed and force [µm]. */
  double lowest_um;
  /** Displacement that the value 255 stands for [µm]. */
  double highest_um;
  /**
   * Displacement of each pixel, row by row from the largest y (a base64 string in JSON). Half a
   * percent of the pixels is clipped at either end.
   */
  tactile_bytes pixels;
} tactile_texture_picture;

/** Description of an effect that can be played by name. */
typedef struct {
  /** Name that `PlayNamedEffect` takes. */
  tactile_text name;
  /** Description for people. */
  tactile_text description;
  /** Duration [s]. */
  double seconds;
} tactile_effect_info;

/** List of `tactile_effect_info`. */
typedef struct {
  const tactile_effect_info *items;
  size_t count;
} tactile_effect_info_list;

/** Answer to `ListEffects`. */
typedef struct {
  /** Identifier of the request that is answered. */
  bool has_id;
  int64_t id;
  /** All effects of the server. */
  tactile_effect_info_list effects;
} tactile_effects;

/** Entry of a map. */
typedef struct {
  tactile_text key;
  int64_t value;
} tactile_integer_entry;

/** Map of `tactile_integer_entry`. */
typedef struct {
  const tactile_integer_entry *items;
  size_t count;
} tactile_integer_map;

/** Answer to a request that was carried out and has no reply of its own. */
typedef struct {
  /** Identifier of the request that is answered. */
  bool has_id;
  int64_t id;
  /** After an `EStop`, the number of the e-stop that was latched, by name of the display. */
  tactile_integer_map estops;
} tactile_done;

/** Answer to `Append`. */
typedef struct {
  /** Identifier of the request that is answered. */
  bool has_id;
  int64_t id;
  /** Number of samples that were taken, counted from the first. */
  int64_t samples_consumed;
  /** Playing time of what is queued for these contactors of this client [ms]. */
  double buffered_ms;
} tactile_appended;

/** Answer to `Ping`. */
typedef struct {
  /** Identifier of the request that is answered. */
  bool has_id;
  int64_t id;
  /** Time in the `Ping` [µs]. */
  int64_t time_us;
  /** Time of the server's monotonic clock when the `Ping` arrived [µs]. */
  int64_t server_time_us;
} tactile_pong;

/** Answer to `GetStats`: the state of a display. */
typedef struct {
  /** Identifier of the request that is answered. */
  bool has_id;
  int64_t id;
  /** Name of the display. */
  tactile_text display;
  /**
   * "disarmed", "armed", "estopped" or "lost". "lost" means that the playback process died and
   * is being restarted.
   */
  tactile_stats_state state;
  /** "up" or "down". */
  tactile_stats_link link;
  /** Reason of a failure or of the e-stop in one line; otherwise the status of the device. */
  tactile_text detail;
  /** Whether a finger touches the display. */
  bool touching;
  /** Whether the finger belongs to this client. */
  bool owner;
  /**
   * Present latency from the arrival of a contact message to the skin: the lead, what the link
   * adds and half a block, whether or not a finger touches; null while nothing plays [ms].
   */
  bool has_latency_ms;
  double latency_ms;
  /** Counters of the device's bus and of playback since it started, by name. */
  tactile_integer_map counters;
  /** Number of the e-stop that holds, 0 if none does. */
  int64_t estop;
  /**
   * Share that was put out of what was due since the display was armed, from 0 to 1, as far as
   * its amplifiers have reported; null if nothing was due.
   */
  bool has_put_out_share;
  double put_out_share;
  /**
   * Time by which drive is sent before it is put out, the part of the latency that bridges
   * delays of the link [ms]; null as long as the device is not open.
   */
  bool has_lead_ms;
  double lead_ms;
} tactile_stats;

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
typedef struct {
  /** Identifier of the request that is answered. */
  bool has_id;
  int64_t id;
  /** Kind of the failure, one of those above. */
  tactile_code code;
  /** Explanation in one line. */
  tactile_text message;
  /**
   * Path of the offending field in the message, such as "layers[0].texture"; empty if no field
   * is to blame.
   */
  tactile_text field;
} tactile_failure;

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
typedef struct {
  /** Name of the display. */
  tactile_text display;
  /** Kind of the event. */
  tactile_text kind;
  /** Explanation in one line. */
  tactile_text detail;
  /** Number of the e-stop that an "estopped" or "cleared" event is about, otherwise 0. */
  int64_t estop;
  /** Contactors that a "touched" or "lifted" event is about, in ascending order. */
  tactile_integer_list contactors;
} tactile_event;

/**
 * Report on a waveform, an effect or tactile frames that were to begin at a time.
 *
 * It comes a third of a second after that, when the amplifier has reported what it put out.
 */
typedef struct {
  /** Name of the display. */
  tactile_text display;
  /** Number that the client gave it in `BeginAt`. */
  int64_t number;
  /** Time at which it was to begin, as in `BeginAt` [µs]. */
  int64_t at_us;
  /**
   * Time of the server's monotonic clock at which its first sample was put out, by the clock of
   * the amplifier; null if it was not [µs].
   */
  bool has_onset_us;
  double onset_us;
  /**
   * Half of the interval around `onset_us` that holds the true time; null if it is not known,
   * as on a sound card [µs].
   */
  bool has_uncertainty_us;
  double uncertainty_us;
  /**
   * Reason in one line why it did not begin, or not at its time, or without its marker; empty if
   * all was as it should be.
   */
  tactile_text reason;
  /**
   * Code that the marker lines have shown with its first sample, as far as the amplifier has
   * confirmed that; 0 for none.
   */
  int64_t marker;
  /** Number of the client that plays it; null if it is the client that gets this message. */
  bool has_client;
  int64_t client;
} tactile_onset;

/** List of `bool`. */
typedef struct {
  const bool *items;
  size_t count;
} tactile_boolean_list;

/** Loads of a finger on the contactors, as playback finds them from their currents. */
typedef struct {
  /** Whether a finger is on each contactor. */
  tactile_boolean_list touching;
  /**
   * Magnitude of the dynamic stiffness of the load on each contactor at 100 Hz; 0 in air [N/m].
   */
  tactile_number_list stiffness_n_m;
  /**
   * Standard deviation of the level of each contactor's shear that follows from the uncertainty
   * of its load; 0 in air [dB].
   */
  tactile_number_list equalizer_error_db;
  /**
   * Whether a load explains the current of each contactor. Where none does, filters for a mean
   * finger play.
   */
  tactile_boolean_list explained;
  /**
   * Whether the guard of an amplifier has turned each contactor down, because it lost the
   * finger. It comes back as soon as what plays is harmless to a bender in air.
   */
  tactile_boolean_list guarded;
} tactile_telemetry_finger;

/** Shear of one contactor, sample by sample. */
typedef struct {
  /** Index of the contactor. */
  int64_t contactor;
  /** Rate of the samples [Hz]. */
  double sample_rate_hz;
  /**
   * Number of the first sample. It continues the message before unless samples are missing, and
   * begins anew when playback is started again.
   */
  int64_t first;
  /**
   * Samples since the message before as little-endian float32, none while nothing plays [µm]; a
   * binary field of MessagePack (a base64 string in JSON).
   */
  tactile_bytes shear_um;
} tactile_telemetry_trace;

/**
 * What playback has handed to the amplifier since the message before, sample by sample.
 *
 * Binary fields are little-endian, and binary fields of MessagePack (base64 strings in JSON). Rows
 * of samples hold a value for each contactor. All is as commanded: after an e-stop, the amplifier
 * turns to 0 V by itself.
 */
typedef struct {
  /**
   * Number of the first sample. It continues the message before unless samples are missing, and
   * begins anew when the server opens the display anew.
   */
  int64_t first;
  /** Nominal rate of the samples [Hz]. */
  double sample_rate_hz;
  /** Number of samples of a block. */
  int64_t block_samples;
  /**
   * Time of the server's monotonic clock at which the first sample of each block is put out, by
   * the clock of the amplifier, as float64 [µs]. Blocks are handed over before that.
   */
  tactile_bytes times_us;
  /**
   * Half of the largest interval around these times that holds the true one; null if it is not
   * known, as on a sound card [µs].
   */
  bool has_uncertainty_us;
  double uncertainty_us;
  /** Time of the server's monotonic clock for which each block has the finger, as float64 [µs]. */
  tactile_bytes finger_times_us;
  /** Position of the finger in each block, as pairs of float32 [mm]. */
  tactile_bytes position_mm;
  /** Velocity of the finger in each block, as pairs of float32 [mm/s]. */
  tactile_bytes velocity_mm_s;
  /** Normal force of the finger in each block, as float32 [N]. */
  tactile_bytes normal_force_n;
  /** Whether the finger touches the surface in each block. */
  tactile_boolean_list touching;
  /**
   * Rows of commanded shear as float32, in step with the drive [µm]; null on a link that takes
   * spectrum frames.
   */
  bool has_shear_um;
  tactile_bytes shear_um;
  /** Rows of drive as float32 [V]; null on a link that takes spectrum frames. */
  bool has_drive_v;
  tactile_bytes drive_v;
} tactile_telemetry_samples;

/** State of a display at one instant, sent at the rate that `Subscribe` asked for. */
typedef struct {
  /** Name of the display. */
  tactile_text display;
  /** Time of the server's monotonic clock [µs]. */
  int64_t time_us;
  /** State as in `StatsReply`. */
  tactile_text state;
  /** Position of the finger on the surface, as playback tracks it [mm]. */
  tactile_pair position_mm;
  /** Velocity of the finger [mm/s]. */
  tactile_pair velocity_mm_s;
  /** Normal force of the finger [N]. */
  double normal_force_n;
  /**
   * Commanded shear of each contactor, 0 while nothing plays [µm]; null on a link that takes
   * spectrum frames, for which it is not computed.
   */
  bool has_shear_um;
  tactile_number_list shear_um;
  /** Drive of each contactor, 0 while nothing plays [V]. */
  tactile_number_list drive_v;
  /** Counters as in `StatsReply`. */
  tactile_integer_map counters;
  /** Share that was put out, as in `StatsReply`. */
  bool has_put_out_share;
  double put_out_share;
  /** Loads of the finger on a display that follows it; null where they are not known. */
  bool has_finger;
  tactile_telemetry_finger finger;
  /**
   * Commanded shear of the contactor that `Subscribe` named; null without one, and on a link
   * that takes spectrum frames.
   */
  bool has_trace;
  tactile_telemetry_trace trace;
  /**
   * Shear of the skin at that contactor on a simulated display, which alone knows it. Its
   * samples are later than those of `trace`, and have numbers of their own.
   */
  bool has_played;
  tactile_telemetry_trace played;
  /** What was handed to the amplifier since the message before, if `Subscribe` asked for it. */
  bool has_samples;
  tactile_telemetry_samples samples;
} tactile_telemetry;

/** Any message of the server: the member of `as` that `type` names. */
typedef struct {
  tactile_type type;
  union {
    tactile_welcome welcome;
    tactile_textures textures;
    tactile_texture_picture texture_picture;
    tactile_effects effects;
    tactile_done done;
    tactile_appended appended;
    tactile_pong pong;
    tactile_stats stats;
    tactile_failure failure;
    tactile_event event;
    tactile_onset onset;
    tactile_telemetry telemetry;
  } as;
} tactile_answer;

/* Tables that describe the structures */

/** Form of a value of MessagePack, or of one that consists of fields. */
typedef enum {
  TACTILE_FORM_NIL,
  TACTILE_FORM_BOOLEAN,
  TACTILE_FORM_INTEGER,
  TACTILE_FORM_NUMBER,
  TACTILE_FORM_TEXT,
  TACTILE_FORM_BYTES,
  TACTILE_FORM_LIST,
  TACTILE_FORM_MAP,
  TACTILE_FORM_EXTENSION,
  /** Text that is one of `names`. */
  TACTILE_FORM_ENUMERATION,
  /** Map of fields. */
  TACTILE_FORM_STRUCTURE,
  /** List of fields in their order. */
  TACTILE_FORM_TUPLE,
  /** Key and value of a map. */
  TACTILE_FORM_ENTRY
} tactile_form;

/** Type of values: their form and size in memory, and the parts that they consist of. */
typedef struct tactile_shape {
  tactile_form form;
  uint16_t size;
  /** Number of fields. */
  uint16_t count;
  const struct tactile_shape *of;
  /** Names of an enumeration, the last of which is NULL, or the type of a message. */
  const char *const *names;
  const struct tactile_field *fields;
} tactile_shape;

/** Rule of when a field is there. */
typedef enum {
  TACTILE_REQUIRED,
  TACTILE_OPTIONAL,
  /** If the flag is set, the field is encoded in place of the next; it is never decoded. */
  TACTILE_INSTEAD
} tactile_rule;

/** Offset of the flag of a field that has none. */
#define TACTILE_NO_FLAG UINT16_MAX

/** Field of a structure: its name, place, flag and default. A flag without default allows null. */
typedef struct tactile_field {
  const char *name;
  const tactile_shape *shape;
  uint16_t place;
  uint16_t flag;
  tactile_rule rule;
  double initial;
} tactile_field;

/** Any list or map in memory. */
typedef struct {
  const void *items;
  size_t count;
} tactile_array;

static const tactile_shape tactile_shape_boolean = {
    TACTILE_FORM_BOOLEAN, sizeof(bool), 0, NULL, NULL, NULL};
static const tactile_shape tactile_shape_integer = {
    TACTILE_FORM_INTEGER, sizeof(int64_t), 0, NULL, NULL, NULL};
static const tactile_shape tactile_shape_number = {
    TACTILE_FORM_NUMBER, sizeof(double), 0, NULL, NULL, NULL};
static const tactile_shape tactile_shape_text = {
    TACTILE_FORM_TEXT, sizeof(tactile_text), 0, NULL, NULL, NULL};
static const tactile_shape tactile_shape_bytes = {
    TACTILE_FORM_BYTES, sizeof(tactile_bytes), 0, NULL, NULL, NULL};
/* Rows: of a field, of one with a flag, and of one whose name is not that of its member. */
#define TACTILE_FIELD(of, member, kind, rule) \
  {#member, &tactile_shape_##kind, offsetof(tactile_##of, member), TACTILE_NO_FLAG, rule, 0}
#define TACTILE_FLAGGED(of, member, kind, rule, initial) \
  TACTILE_NAMED(#member, of, member, kind, rule, initial)
#define TACTILE_NAMED(name, of, member, kind, rule, initial)                                   \
  {                                                                                            \
    name, &tactile_shape_##kind, offsetof(tactile_##of, member),                               \
        offsetof(tactile_##of, has_##member), rule, initial                                    \
  }

static const tactile_field tactile_fields_pair[] = {
    TACTILE_FIELD(pair, first, number, TACTILE_REQUIRED),
    TACTILE_FIELD(pair, second, number, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_pair = {
    TACTILE_FORM_TUPLE, sizeof(tactile_pair), 2, NULL, NULL, tactile_fields_pair};

static const char *const tactile_tag_hello[] = {"hello"};
static const tactile_field tactile_fields_hello[] = {
    TACTILE_FLAGGED(hello, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(hello, client, text, TACTILE_REQUIRED),
    TACTILE_FLAGGED(hello, version, integer, TACTILE_OPTIONAL, 1.0),
    TACTILE_FIELD(hello, token, text, TACTILE_OPTIONAL),
};
static const tactile_shape tactile_shape_hello = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_hello), 4,
    NULL, tactile_tag_hello, tactile_fields_hello};

static const char *const tactile_tag_list_textures[] = {"list_textures"};
static const tactile_field tactile_fields_list_textures[] = {
    TACTILE_FLAGGED(list_textures, id, integer, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_list_textures = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_list_textures), 1,
    NULL, tactile_tag_list_textures, tactile_fields_list_textures};

static const char *const tactile_tag_draw_texture[] = {"draw_texture"};
static const tactile_field tactile_fields_draw_texture[] = {
    TACTILE_FLAGGED(draw_texture, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(draw_texture, texture, text, TACTILE_REQUIRED),
    TACTILE_FIELD(draw_texture, seed, integer, TACTILE_OPTIONAL),
    TACTILE_FIELD(draw_texture, left_mm, number, TACTILE_REQUIRED),
    TACTILE_FIELD(draw_texture, bottom_mm, number, TACTILE_REQUIRED),
    TACTILE_FIELD(draw_texture, pixel_mm, number, TACTILE_REQUIRED),
    TACTILE_FIELD(draw_texture, columns, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(draw_texture, rows, integer, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_draw_texture = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_draw_texture), 8,
    NULL, tactile_tag_draw_texture, tactile_fields_draw_texture};

static const tactile_field tactile_fields_layer[] = {
    TACTILE_FIELD(layer, texture, text, TACTILE_REQUIRED),
    TACTILE_FLAGGED(layer, gain, number, TACTILE_OPTIONAL, 1.0),
    TACTILE_FIELD(layer, seed, integer, TACTILE_OPTIONAL),
};
static const tactile_shape tactile_shape_layer = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_layer), 3,
    NULL, NULL, tactile_fields_layer};

static const tactile_shape tactile_shape_layer_list = {
    TACTILE_FORM_LIST, sizeof(tactile_layer_list), 0,
    &tactile_shape_layer, NULL, NULL};

static const char *const tactile_tag_select[] = {"select"};
static const tactile_field tactile_fields_select[] = {
    TACTILE_FLAGGED(select, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(select, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(select, layers, layer_list, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_select = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_select), 3,
    NULL, tactile_tag_select, tactile_fields_select};

static const char *const tactile_tag_contact[] = {"contact"};
static const tactile_field tactile_fields_contact[] = {
    TACTILE_FIELD(contact, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(contact, position_mm, pair, TACTILE_REQUIRED),
    TACTILE_FIELD(contact, normal_force_n, number, TACTILE_REQUIRED),
    TACTILE_FLAGGED(contact, time_us, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FLAGGED(contact, velocity_mm_s, pair, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_contact = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_contact), 5,
    NULL, tactile_tag_contact, tactile_fields_contact};

static const char *const tactile_tag_play[] = {"play"};
static const tactile_field tactile_fields_play[] = {
    TACTILE_FLAGGED(play, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(play, display, text, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_play = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_play), 2,
    NULL, tactile_tag_play, tactile_fields_play};

static const char *const tactile_tag_stop[] = {"stop"};
static const tactile_field tactile_fields_stop[] = {
    TACTILE_FLAGGED(stop, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(stop, display, text, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_stop = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_stop), 2,
    NULL, tactile_tag_stop, tactile_fields_stop};

static const char *const tactile_tag_gain[] = {"gain"};
static const tactile_field tactile_fields_gain[] = {
    TACTILE_FLAGGED(gain, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(gain, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(gain, gain, number, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_gain = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_gain), 3,
    NULL, tactile_tag_gain, tactile_fields_gain};

static const tactile_shape tactile_shape_number_list = {
    TACTILE_FORM_LIST, sizeof(tactile_number_list), 0,
    &tactile_shape_number, NULL, NULL};

static const tactile_shape tactile_shape_integer_list = {
    TACTILE_FORM_LIST, sizeof(tactile_integer_list), 0,
    &tactile_shape_integer, NULL, NULL};

static const tactile_field tactile_fields_begin_at[] = {
    TACTILE_FIELD(begin_at, at_us, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(begin_at, drop_late, boolean, TACTILE_OPTIONAL),
    TACTILE_FIELD(begin_at, number, integer, TACTILE_OPTIONAL),
    TACTILE_FIELD(begin_at, marker, integer, TACTILE_OPTIONAL),
};
static const tactile_shape tactile_shape_begin_at = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_begin_at), 4,
    NULL, NULL, tactile_fields_begin_at};

static const char *const tactile_tag_append[] = {"append"};
static const tactile_field tactile_fields_append[] = {
    TACTILE_FLAGGED(append, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(append, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(append, sample_rate_hz, number, TACTILE_REQUIRED),
    TACTILE_FIELD(append, amplitude_um, number, TACTILE_REQUIRED),
    TACTILE_NAMED("samples", append, samples_bytes, bytes, TACTILE_INSTEAD, 0),
    TACTILE_FIELD(append, samples, number_list, TACTILE_REQUIRED),
    TACTILE_FLAGGED(append, append, boolean, TACTILE_OPTIONAL, 1.0),
    TACTILE_FIELD(append, contactors, integer_list, TACTILE_OPTIONAL),
    TACTILE_FLAGGED(append, begin, begin_at, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_append = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_append), 9,
    NULL, tactile_tag_append, tactile_fields_append};

static const char *const tactile_tag_frames[] = {"frames"};
static const tactile_field tactile_fields_frames[] = {
    TACTILE_FIELD(frames, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(frames, frame_rate_hz, number, TACTILE_REQUIRED),
    TACTILE_FIELD(frames, amplitude_um, number, TACTILE_REQUIRED),
    TACTILE_NAMED("frames", frames, frames_bytes, bytes, TACTILE_INSTEAD, 0),
    TACTILE_FIELD(frames, frames, number_list, TACTILE_REQUIRED),
    TACTILE_FIELD(frames, latest, boolean, TACTILE_OPTIONAL),
    TACTILE_FLAGGED(frames, begin, begin_at, TACTILE_OPTIONAL, 0.0),
    TACTILE_FLAGGED(frames, time_us, integer, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_frames = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_frames), 8,
    NULL, tactile_tag_frames, tactile_fields_frames};

static const tactile_field tactile_fields_point[] = {
    TACTILE_FIELD(point, time_ms, number, TACTILE_REQUIRED),
    TACTILE_FIELD(point, value, number, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_point = {
    TACTILE_FORM_TUPLE, sizeof(tactile_point), 2,
    NULL, NULL, tactile_fields_point};

static const tactile_shape tactile_shape_point_list = {
    TACTILE_FORM_LIST, sizeof(tactile_point_list), 0,
    &tactile_shape_point, NULL, NULL};

static const tactile_field tactile_fields_frequency_point[] = {
    TACTILE_FIELD(frequency_point, time_ms, number, TACTILE_REQUIRED),
    TACTILE_FIELD(frequency_point, frequency_hz, number, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_frequency_point = {
    TACTILE_FORM_TUPLE, sizeof(tactile_frequency_point), 2,
    NULL, NULL, tactile_fields_frequency_point};

static const tactile_shape tactile_shape_frequency_point_list = {
    TACTILE_FORM_LIST, sizeof(tactile_frequency_point_list), 0,
    &tactile_shape_frequency_point, NULL, NULL};

static const tactile_field tactile_fields_transient[] = {
    TACTILE_FIELD(transient, time_ms, number, TACTILE_REQUIRED),
    TACTILE_FIELD(transient, value, number, TACTILE_REQUIRED),
    TACTILE_FLAGGED(transient, frequency_hz, number, TACTILE_OPTIONAL, 160.0),
};
static const tactile_shape tactile_shape_transient = {
    TACTILE_FORM_TUPLE, sizeof(tactile_transient), 3,
    NULL, NULL, tactile_fields_transient};

static const tactile_shape tactile_shape_transient_list = {
    TACTILE_FORM_LIST, sizeof(tactile_transient_list), 0,
    &tactile_shape_transient, NULL, NULL};

static const char *const tactile_tag_effect[] = {"effect"};
static const tactile_field tactile_fields_effect[] = {
    TACTILE_FLAGGED(effect, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(effect, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(effect, amplitude_um, number, TACTILE_REQUIRED),
    TACTILE_FIELD(effect, amplitude, point_list, TACTILE_OPTIONAL),
    TACTILE_FIELD(effect, frequency, frequency_point_list, TACTILE_OPTIONAL),
    TACTILE_FIELD(effect, transients, transient_list, TACTILE_OPTIONAL),
    TACTILE_FIELD(effect, stream, boolean, TACTILE_OPTIONAL),
    TACTILE_FLAGGED(effect, begin, begin_at, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_effect = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_effect), 8,
    NULL, tactile_tag_effect, tactile_fields_effect};

static const char *const tactile_tag_list_effects[] = {"list_effects"};
static const tactile_field tactile_fields_list_effects[] = {
    TACTILE_FLAGGED(list_effects, id, integer, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_list_effects = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_list_effects), 1,
    NULL, tactile_tag_list_effects, tactile_fields_list_effects};

static const char *const tactile_tag_play_effect[] = {"play_effect"};
static const tactile_field tactile_fields_play_effect[] = {
    TACTILE_FLAGGED(play_effect, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(play_effect, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(play_effect, effect, text, TACTILE_REQUIRED),
    TACTILE_FLAGGED(play_effect, gain, number, TACTILE_OPTIONAL, 1.0),
    TACTILE_FLAGGED(play_effect, begin, begin_at, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_play_effect = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_play_effect), 5,
    NULL, tactile_tag_play_effect, tactile_fields_play_effect};

static const char *const tactile_tag_arm[] = {"arm"};
static const tactile_field tactile_fields_arm[] = {
    TACTILE_FLAGGED(arm, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(arm, display, text, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_arm = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_arm), 2,
    NULL, tactile_tag_arm, tactile_fields_arm};

static const char *const tactile_tag_disarm[] = {"disarm"};
static const tactile_field tactile_fields_disarm[] = {
    TACTILE_FLAGGED(disarm, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(disarm, display, text, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_disarm = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_disarm), 2,
    NULL, tactile_tag_disarm, tactile_fields_disarm};

static const char *const tactile_tag_estop[] = {"estop"};
static const tactile_field tactile_fields_estop[] = {
    TACTILE_FLAGGED(estop, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FLAGGED(estop, display, text, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_estop = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_estop), 2,
    NULL, tactile_tag_estop, tactile_fields_estop};

static const char *const tactile_tag_clear[] = {"clear"};
static const tactile_field tactile_fields_clear[] = {
    TACTILE_FLAGGED(clear, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(clear, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(clear, estop, integer, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_clear = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_clear), 3,
    NULL, tactile_tag_clear, tactile_fields_clear};

static const char *const tactile_tag_subscribe[] = {"subscribe"};
static const tactile_field tactile_fields_subscribe[] = {
    TACTILE_FLAGGED(subscribe, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(subscribe, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(subscribe, rate_hz, number, TACTILE_REQUIRED),
    TACTILE_FLAGGED(subscribe, contactor, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(subscribe, samples, boolean, TACTILE_OPTIONAL),
};
static const tactile_shape tactile_shape_subscribe = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_subscribe), 5,
    NULL, tactile_tag_subscribe, tactile_fields_subscribe};

static const char *const tactile_tag_get_stats[] = {"get_stats"};
static const tactile_field tactile_fields_get_stats[] = {
    TACTILE_FLAGGED(get_stats, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(get_stats, display, text, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_get_stats = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_get_stats), 2,
    NULL, tactile_tag_get_stats, tactile_fields_get_stats};

static const char *const tactile_tag_ping[] = {"ping"};
static const tactile_field tactile_fields_ping[] = {
    TACTILE_FLAGGED(ping, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(ping, time_us, integer, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_ping = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_ping), 2,
    NULL, tactile_tag_ping, tactile_fields_ping};

static const tactile_shape tactile_shape_pair_list = {
    TACTILE_FORM_LIST, sizeof(tactile_pair_list), 0,
    &tactile_shape_pair, NULL, NULL};

static const tactile_field tactile_fields_display_description[] = {
    TACTILE_FIELD(display_description, name, text, TACTILE_REQUIRED),
    TACTILE_FIELD(display_description, contactors_mm, pair_list, TACTILE_REQUIRED),
    TACTILE_FIELD(display_description, shear_direction_deg, number_list, TACTILE_REQUIRED),
    TACTILE_FIELD(display_description, sample_rate_hz, number, TACTILE_REQUIRED),
    TACTILE_FIELD(display_description, voltage_limit_v, number, TACTILE_REQUIRED),
    TACTILE_FIELD(display_description, waveforms, boolean, TACTILE_REQUIRED),
    TACTILE_FIELD(display_description, latency_ms, number, TACTILE_REQUIRED),
    TACTILE_FIELD(display_description, estop, integer, TACTILE_OPTIONAL),
    TACTILE_FIELD(display_description, latest_estop, integer, TACTILE_OPTIONAL),
    TACTILE_FIELD(display_description, follows, boolean, TACTILE_OPTIONAL),
    TACTILE_FIELD(display_description, threshold_um, pair_list, TACTILE_OPTIONAL),
    TACTILE_FIELD(display_description, marker_lines, integer, TACTILE_OPTIONAL),
};
static const tactile_shape tactile_shape_display_description = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_display_description), 12,
    NULL, NULL, tactile_fields_display_description};

static const tactile_shape tactile_shape_display_description_list = {
    TACTILE_FORM_LIST, sizeof(tactile_display_description_list), 0,
    &tactile_shape_display_description, NULL, NULL};

static const tactile_shape tactile_shape_role = {
    TACTILE_FORM_ENUMERATION, sizeof(tactile_role), 0,
    NULL, tactile_names_role, NULL};

static const tactile_shape tactile_shape_role_list = {
    TACTILE_FORM_LIST, sizeof(tactile_role_list), 0,
    &tactile_shape_role, NULL, NULL};

static const char *const tactile_tag_welcome[] = {"welcome"};
static const tactile_field tactile_fields_welcome[] = {
    TACTILE_FLAGGED(welcome, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(welcome, server, text, TACTILE_REQUIRED),
    TACTILE_FIELD(welcome, version, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(welcome, session, text, TACTILE_REQUIRED),
    TACTILE_FIELD(welcome, displays, display_description_list, TACTILE_REQUIRED),
    TACTILE_FIELD(welcome, may_arm, boolean, TACTILE_REQUIRED),
    TACTILE_FIELD(welcome, time_us, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(welcome, roles, role_list, TACTILE_OPTIONAL),
    TACTILE_FLAGGED(welcome, largest_message, integer, TACTILE_OPTIONAL, 65536.0),
    TACTILE_FIELD(welcome, messages_per_second, integer, TACTILE_OPTIONAL),
};
static const tactile_shape tactile_shape_welcome = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_welcome), 10,
    NULL, tactile_tag_welcome, tactile_fields_welcome};

static const tactile_field tactile_fields_texture_info[] = {
    TACTILE_FIELD(texture_info, name, text, TACTILE_REQUIRED),
    TACTILE_FIELD(texture_info, category, text, TACTILE_REQUIRED),
    TACTILE_FIELD(texture_info, description, text, TACTILE_REQUIRED),
    TACTILE_FIELD(texture_info, provenance, text, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_texture_info = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_texture_info), 4,
    NULL, NULL, tactile_fields_texture_info};

static const tactile_shape tactile_shape_texture_info_list = {
    TACTILE_FORM_LIST, sizeof(tactile_texture_info_list), 0,
    &tactile_shape_texture_info, NULL, NULL};

static const char *const tactile_tag_textures[] = {"textures"};
static const tactile_field tactile_fields_textures[] = {
    TACTILE_FLAGGED(textures, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(textures, textures, texture_info_list, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_textures = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_textures), 2,
    NULL, tactile_tag_textures, tactile_fields_textures};

static const char *const tactile_tag_texture_picture[] = {"texture_picture"};
static const tactile_field tactile_fields_texture_picture[] = {
    TACTILE_FLAGGED(texture_picture, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(texture_picture, lowest_um, number, TACTILE_REQUIRED),
    TACTILE_FIELD(texture_picture, highest_um, number, TACTILE_REQUIRED),
    TACTILE_FIELD(texture_picture, pixels, bytes, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_texture_picture = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_texture_picture), 4,
    NULL, tactile_tag_texture_picture, tactile_fields_texture_picture};

static const tactile_field tactile_fields_effect_info[] = {
    TACTILE_FIELD(effect_info, name, text, TACTILE_REQUIRED),
    TACTILE_FIELD(effect_info, description, text, TACTILE_REQUIRED),
    TACTILE_FIELD(effect_info, seconds, number, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_effect_info = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_effect_info), 3,
    NULL, NULL, tactile_fields_effect_info};

static const tactile_shape tactile_shape_effect_info_list = {
    TACTILE_FORM_LIST, sizeof(tactile_effect_info_list), 0,
    &tactile_shape_effect_info, NULL, NULL};

static const char *const tactile_tag_effects[] = {"effects"};
static const tactile_field tactile_fields_effects[] = {
    TACTILE_FLAGGED(effects, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(effects, effects, effect_info_list, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_effects = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_effects), 2,
    NULL, tactile_tag_effects, tactile_fields_effects};

static const tactile_field tactile_fields_integer_entry[] = {
    TACTILE_FIELD(integer_entry, key, text, TACTILE_REQUIRED),
    TACTILE_FIELD(integer_entry, value, integer, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_integer_entry = {
    TACTILE_FORM_ENTRY, sizeof(tactile_integer_entry), 2,
    NULL, NULL, tactile_fields_integer_entry};
static const tactile_shape tactile_shape_integer_map = {
    TACTILE_FORM_MAP, sizeof(tactile_integer_map), 0,
    &tactile_shape_integer_entry, NULL, NULL};

static const char *const tactile_tag_done[] = {"done"};
static const tactile_field tactile_fields_done[] = {
    TACTILE_FLAGGED(done, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(done, estops, integer_map, TACTILE_OPTIONAL),
};
static const tactile_shape tactile_shape_done = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_done), 2,
    NULL, tactile_tag_done, tactile_fields_done};

static const char *const tactile_tag_appended[] = {"appended"};
static const tactile_field tactile_fields_appended[] = {
    TACTILE_FLAGGED(appended, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(appended, samples_consumed, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(appended, buffered_ms, number, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_appended = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_appended), 3,
    NULL, tactile_tag_appended, tactile_fields_appended};

static const char *const tactile_tag_pong[] = {"pong"};
static const tactile_field tactile_fields_pong[] = {
    TACTILE_FLAGGED(pong, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(pong, time_us, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(pong, server_time_us, integer, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_pong = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_pong), 3,
    NULL, tactile_tag_pong, tactile_fields_pong};

static const tactile_shape tactile_shape_stats_state = {
    TACTILE_FORM_ENUMERATION, sizeof(tactile_stats_state), 0,
    NULL, tactile_names_stats_state, NULL};

static const tactile_shape tactile_shape_stats_link = {
    TACTILE_FORM_ENUMERATION, sizeof(tactile_stats_link), 0,
    NULL, tactile_names_stats_link, NULL};

static const char *const tactile_tag_stats[] = {"stats"};
static const tactile_field tactile_fields_stats[] = {
    TACTILE_FLAGGED(stats, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(stats, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(stats, state, stats_state, TACTILE_REQUIRED),
    TACTILE_FIELD(stats, link, stats_link, TACTILE_REQUIRED),
    TACTILE_FIELD(stats, detail, text, TACTILE_REQUIRED),
    TACTILE_FIELD(stats, touching, boolean, TACTILE_REQUIRED),
    TACTILE_FIELD(stats, owner, boolean, TACTILE_REQUIRED),
    TACTILE_FLAGGED(stats, latency_ms, number, TACTILE_REQUIRED, 0.0),
    TACTILE_FIELD(stats, counters, integer_map, TACTILE_REQUIRED),
    TACTILE_FIELD(stats, estop, integer, TACTILE_OPTIONAL),
    TACTILE_FLAGGED(stats, put_out_share, number, TACTILE_OPTIONAL, 0.0),
    TACTILE_FLAGGED(stats, lead_ms, number, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_stats = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_stats), 12,
    NULL, tactile_tag_stats, tactile_fields_stats};

static const tactile_shape tactile_shape_code = {
    TACTILE_FORM_ENUMERATION, sizeof(tactile_code), 0,
    NULL, tactile_names_code, NULL};

static const char *const tactile_tag_failure[] = {"failure"};
static const tactile_field tactile_fields_failure[] = {
    TACTILE_FLAGGED(failure, id, integer, TACTILE_OPTIONAL, 0.0),
    TACTILE_FIELD(failure, code, code, TACTILE_REQUIRED),
    TACTILE_FIELD(failure, message, text, TACTILE_REQUIRED),
    TACTILE_FIELD(failure, field, text, TACTILE_OPTIONAL),
};
static const tactile_shape tactile_shape_failure = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_failure), 4,
    NULL, tactile_tag_failure, tactile_fields_failure};

static const char *const tactile_tag_event[] = {"event"};
static const tactile_field tactile_fields_event[] = {
    TACTILE_FIELD(event, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(event, kind, text, TACTILE_REQUIRED),
    TACTILE_FIELD(event, detail, text, TACTILE_OPTIONAL),
    TACTILE_FIELD(event, estop, integer, TACTILE_OPTIONAL),
    TACTILE_FIELD(event, contactors, integer_list, TACTILE_OPTIONAL),
};
static const tactile_shape tactile_shape_event = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_event), 5,
    NULL, tactile_tag_event, tactile_fields_event};

static const char *const tactile_tag_onset[] = {"onset"};
static const tactile_field tactile_fields_onset[] = {
    TACTILE_FIELD(onset, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(onset, number, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(onset, at_us, integer, TACTILE_REQUIRED),
    TACTILE_FLAGGED(onset, onset_us, number, TACTILE_REQUIRED, 0.0),
    TACTILE_FLAGGED(onset, uncertainty_us, number, TACTILE_REQUIRED, 0.0),
    TACTILE_FIELD(onset, reason, text, TACTILE_OPTIONAL),
    TACTILE_FIELD(onset, marker, integer, TACTILE_OPTIONAL),
    TACTILE_FLAGGED(onset, client, integer, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_onset = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_onset), 8,
    NULL, tactile_tag_onset, tactile_fields_onset};

static const tactile_shape tactile_shape_boolean_list = {
    TACTILE_FORM_LIST, sizeof(tactile_boolean_list), 0,
    &tactile_shape_boolean, NULL, NULL};

static const tactile_field tactile_fields_telemetry_finger[] = {
    TACTILE_FIELD(telemetry_finger, touching, boolean_list, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_finger, stiffness_n_m, number_list, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_finger, equalizer_error_db, number_list, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_finger, explained, boolean_list, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_finger, guarded, boolean_list, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_telemetry_finger = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_telemetry_finger), 5,
    NULL, NULL, tactile_fields_telemetry_finger};

static const tactile_field tactile_fields_telemetry_trace[] = {
    TACTILE_FIELD(telemetry_trace, contactor, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_trace, sample_rate_hz, number, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_trace, first, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_trace, shear_um, bytes, TACTILE_REQUIRED),
};
static const tactile_shape tactile_shape_telemetry_trace = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_telemetry_trace), 4,
    NULL, NULL, tactile_fields_telemetry_trace};

static const tactile_field tactile_fields_telemetry_samples[] = {
    TACTILE_FIELD(telemetry_samples, first, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_samples, sample_rate_hz, number, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_samples, block_samples, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_samples, times_us, bytes, TACTILE_REQUIRED),
    TACTILE_FLAGGED(telemetry_samples, uncertainty_us, number, TACTILE_REQUIRED, 0.0),
    TACTILE_FIELD(telemetry_samples, finger_times_us, bytes, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_samples, position_mm, bytes, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_samples, velocity_mm_s, bytes, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_samples, normal_force_n, bytes, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry_samples, touching, boolean_list, TACTILE_REQUIRED),
    TACTILE_FLAGGED(telemetry_samples, shear_um, bytes, TACTILE_REQUIRED, 0.0),
    TACTILE_FLAGGED(telemetry_samples, drive_v, bytes, TACTILE_REQUIRED, 0.0),
};
static const tactile_shape tactile_shape_telemetry_samples = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_telemetry_samples), 12,
    NULL, NULL, tactile_fields_telemetry_samples};

static const char *const tactile_tag_telemetry[] = {"telemetry"};
static const tactile_field tactile_fields_telemetry[] = {
    TACTILE_FIELD(telemetry, display, text, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry, time_us, integer, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry, state, text, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry, position_mm, pair, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry, velocity_mm_s, pair, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry, normal_force_n, number, TACTILE_REQUIRED),
    TACTILE_FLAGGED(telemetry, shear_um, number_list, TACTILE_REQUIRED, 0.0),
    TACTILE_FIELD(telemetry, drive_v, number_list, TACTILE_REQUIRED),
    TACTILE_FIELD(telemetry, counters, integer_map, TACTILE_REQUIRED),
    TACTILE_FLAGGED(telemetry, put_out_share, number, TACTILE_OPTIONAL, 0.0),
    TACTILE_FLAGGED(telemetry, finger, telemetry_finger, TACTILE_OPTIONAL, 0.0),
    TACTILE_FLAGGED(telemetry, trace, telemetry_trace, TACTILE_OPTIONAL, 0.0),
    TACTILE_FLAGGED(telemetry, played, telemetry_trace, TACTILE_OPTIONAL, 0.0),
    TACTILE_FLAGGED(telemetry, samples, telemetry_samples, TACTILE_OPTIONAL, 0.0),
};
static const tactile_shape tactile_shape_telemetry = {
    TACTILE_FORM_STRUCTURE, sizeof(tactile_telemetry), 14,
    NULL, tactile_tag_telemetry, tactile_fields_telemetry};

#undef TACTILE_FIELD
#undef TACTILE_FLAGGED
#undef TACTILE_NAMED

/* Encoding */

/** Writer of MessagePack. */
typedef struct {
  uint8_t *out;
  size_t room;
  size_t size;
  bool full;
} tactile_writer;

static inline void tactile_write_raw(tactile_writer *w, const void *data, size_t size) {
  w->full = w->full || size > w->room - w->size;
  if (w->full || size == 0) return;
  memcpy(w->out + w->size, data, size);
  w->size += size;
}

/** Write a byte, and behind it a number in `size` bytes. */
static inline void tactile_write_code(tactile_writer *w, unsigned code, uint64_t n, size_t size) {
  uint8_t bytes[9];
  bytes[0] = (uint8_t)code;
  for (size_t i = 0; i < size; i++) bytes[1 + i] = (uint8_t)(n >> (8 * (size - 1 - i)));
  tactile_write_raw(w, bytes, 1 + size);
}

/**
 * Write a length: in the first byte if it is below `fixed`, else after `code8` if there is one,
 * after `code16`, or after the code behind that.
 */
static inline void tactile_write_head(tactile_writer *w, size_t length, size_t fixed, unsigned base,
                                      unsigned code8, unsigned code16) {
  if (length < fixed) {
    tactile_write_code(w, base | (unsigned)length, 0, 0);
  } else if (code8 != 0 && length < 0x100) {
    tactile_write_code(w, code8, length, 1);
  } else if (length < 0x10000) {
    tactile_write_code(w, code16, length, 2);
  } else if (length >> 16 >> 16 == 0) {
    tactile_write_code(w, code16 + 1, length, 4);
  } else {
    w->full = true;
  }
}

static inline void tactile_write_text(tactile_writer *w, tactile_text text) {
  tactile_write_head(w, text.size, 32, 0xa0, 0xd9, 0xda);
  tactile_write_raw(w, text.data, text.size);
}

static inline void tactile_write_bytes(tactile_writer *w, tactile_bytes bytes) {
  tactile_write_head(w, bytes.size, 0, 0, 0xc4, 0xc5);
  tactile_write_raw(w, bytes.data, bytes.size);
}

static inline void tactile_write_integer(tactile_writer *w, int64_t value) {
  uint64_t bits = (uint64_t)value;
  uint64_t extent = value < 0 ? 2 * ~bits + 1 : bits;
  unsigned power = extent < 0x100 ? 0 : extent < 0x10000 ? 1 : extent <= 0xffffffffu ? 2 : 3;
  if (value >= -32 && value < 128) {
    tactile_write_code(w, (unsigned)(bits & 0xff), 0, 0);
  } else {
    tactile_write_code(w, (value < 0 ? 0xd0u : 0xccu) + power, bits, (size_t)1 << power);
  }
}

static inline void tactile_write_number(tactile_writer *w, double value) {
  uint64_t bits;
  memcpy(&bits, &value, 8);
  tactile_write_code(w, 0xcb, bits, 8);
}

/** Return whether a field differs from its default: by its flag, or because it is not zero. */
static inline bool tactile_is_set(const tactile_field *field, const char *m) {
  const void *value = m + field->place;
  tactile_array array;
  if (field->flag != TACTILE_NO_FLAG) return *(const bool *)(const void *)(m + field->flag);
  switch (field->shape->form) {
    case TACTILE_FORM_BOOLEAN: return *(const bool *)value;
    case TACTILE_FORM_INTEGER: return *(const int64_t *)value != 0;
    case TACTILE_FORM_NUMBER: return *(const double *)value != 0;
    case TACTILE_FORM_TEXT: return ((const tactile_text *)value)->size > 0;
    default: memcpy(&array, value, sizeof array); return array.count > 0;
  }
}

/** Return the next field that is to be encoded from row `i` on, and advance; NULL at the end. */
static inline const tactile_field *tactile_next_field(const tactile_shape *shape, const char *m,
                                                      size_t *i) {
  while (*i < shape->count) {
    const tactile_field *field = &shape->fields[(*i)++];
    if (field->rule != TACTILE_REQUIRED && !tactile_is_set(field, m)) continue;
    if (field->rule == TACTILE_INSTEAD) (*i)++;
    return field;
  }
  return NULL;
}

static inline void tactile_write_value(tactile_writer *w, const tactile_shape *shape,
                                       const void *value);

static inline void tactile_write_fields(tactile_writer *w, const tactile_shape *shape,
                                        const char *m) {
  bool named = shape->form == TACTILE_FORM_STRUCTURE;
  const tactile_field *field;
  size_t tags = shape->names != NULL ? 1 : 0;
  size_t count = tags;
  for (size_t i = 0; tactile_next_field(shape, m, &i) != NULL;) count++;
  tactile_write_head(w, count, 16, named ? 0x80 : 0x90, 0, named ? 0xde : 0xdc);
  if (tags > 0) {
    tactile_write_text(w, tactile_text_of("type"));
    tactile_write_text(w, tactile_text_of(shape->names[0]));
  }
  for (size_t i = 0; (field = tactile_next_field(shape, m, &i)) != NULL;) {
    if (named) tactile_write_text(w, tactile_text_of(field->name));
    tactile_write_value(w, field->shape, m + field->place);
  }
}

static inline void tactile_write_list(tactile_writer *w, const tactile_shape *item,
                                      const void *value) {
  tactile_array list;
  memcpy(&list, value, sizeof list);
  tactile_write_head(w, list.count, 16, 0x90, 0, 0xdc);
  for (size_t i = 0; i < list.count; i++) {
    tactile_write_value(w, item, (const char *)list.items + i * item->size);
  }
}

static inline void tactile_write_value(tactile_writer *w, const tactile_shape *shape,
                                       const void *value) {
  switch (shape->form) {
    case TACTILE_FORM_BOOLEAN:
      tactile_write_code(w, *(const bool *)value ? 0xc3 : 0xc2, 0, 0);
      break;
    case TACTILE_FORM_INTEGER: tactile_write_integer(w, *(const int64_t *)value); break;
    case TACTILE_FORM_NUMBER: tactile_write_number(w, *(const double *)value); break;
    case TACTILE_FORM_TEXT: tactile_write_text(w, *(const tactile_text *)value); break;
    case TACTILE_FORM_BYTES: tactile_write_bytes(w, *(const tactile_bytes *)value); break;
    case TACTILE_FORM_LIST: tactile_write_list(w, shape->of, value); break;
    default: tactile_write_fields(w, shape, (const char *)value);
  }
}

static inline size_t tactile_encode(const tactile_shape *shape, const void *message, uint8_t *out,
                                    size_t room) {
  tactile_writer w = {out, room, 0, false};
  tactile_write_value(&w, shape, message);
  return w.full ? 0 : w.size;
}

/* Each function encodes a message and returns its size; 0 if there is no room for it. */

static inline size_t tactile_encode_hello(
    const tactile_hello *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_hello, message, out, room);
}

static inline size_t tactile_encode_list_textures(
    const tactile_list_textures *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_list_textures, message, out, room);
}

static inline size_t tactile_encode_draw_texture(
    const tactile_draw_texture *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_draw_texture, message, out, room);
}

static inline size_t tactile_encode_select(
    const tactile_select *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_select, message, out, room);
}

static inline size_t tactile_encode_contact(
    const tactile_contact *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_contact, message, out, room);
}

static inline size_t tactile_encode_play(
    const tactile_play *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_play, message, out, room);
}

static inline size_t tactile_encode_stop(
    const tactile_stop *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_stop, message, out, room);
}

static inline size_t tactile_encode_gain(
    const tactile_gain *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_gain, message, out, room);
}

static inline size_t tactile_encode_append(
    const tactile_append *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_append, message, out, room);
}

static inline size_t tactile_encode_frames(
    const tactile_frames *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_frames, message, out, room);
}

static inline size_t tactile_encode_effect(
    const tactile_effect *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_effect, message, out, room);
}

static inline size_t tactile_encode_list_effects(
    const tactile_list_effects *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_list_effects, message, out, room);
}

static inline size_t tactile_encode_play_effect(
    const tactile_play_effect *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_play_effect, message, out, room);
}

static inline size_t tactile_encode_arm(
    const tactile_arm *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_arm, message, out, room);
}

static inline size_t tactile_encode_disarm(
    const tactile_disarm *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_disarm, message, out, room);
}

static inline size_t tactile_encode_estop(
    const tactile_estop *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_estop, message, out, room);
}

static inline size_t tactile_encode_clear(
    const tactile_clear *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_clear, message, out, room);
}

static inline size_t tactile_encode_subscribe(
    const tactile_subscribe *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_subscribe, message, out, room);
}

static inline size_t tactile_encode_get_stats(
    const tactile_get_stats *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_get_stats, message, out, room);
}

static inline size_t tactile_encode_ping(
    const tactile_ping *message, uint8_t *out, size_t room) {
  return tactile_encode(&tactile_shape_ping, message, out, room);
}

/* Decoding */

/** Outcome of `tactile_decode`. */
typedef enum {
  /** The answer was decoded. */
  TACTILE_OK,
  /** The type is not one of this version of the API; ignore the message. */
  TACTILE_UNKNOWN_TYPE,
  /** The bytes are not one value of MessagePack. */
  TACTILE_MALFORMED,
  /** A field is missing or is of another type. */
  TACTILE_INVALID,
  /** The memory does not suffice for the lists. */
  TACTILE_NO_MEMORY
} tactile_status;

/** Value, or the head of a list or map; `count` is the number of bytes, items or pairs. */
typedef struct {
  tactile_form form;
  int64_t integer;
  double number;
  const uint8_t *data;
  size_t count;
} tactile_value;

/** Reader of MessagePack with the memory for lists; `status` is the first error. */
typedef struct {
  const uint8_t *data;
  size_t size;
  size_t at;
  uint8_t *memory;
  size_t room;
  size_t used;
  tactile_status status;
} tactile_reader;

static inline void tactile_fail(tactile_reader *r, tactile_status status) {
  if (r->status == TACTILE_OK) r->status = status;
}

/** Pass over bytes and return where they begin, or NULL if there are not as many. */
static inline const uint8_t *tactile_take(tactile_reader *r, size_t size) {
  if (r->status == TACTILE_OK && size > r->size - r->at) tactile_fail(r, TACTILE_MALFORMED);
  if (r->status != TACTILE_OK) return NULL;
  r->at += size;
  return r->data + (r->at - size);
}

/** Read a number of 1 << power bytes; 0 after an error. */
static inline uint64_t tactile_read_uint(tactile_reader *r, unsigned power) {
  size_t size = (size_t)1 << power;
  const uint8_t *bytes = tactile_take(r, size);
  uint64_t value = 0;
  for (size_t i = 0; bytes != NULL && i < size; i++) value = value << 8 | bytes[i];
  return value;
}

static inline void tactile_next_number(tactile_reader *r, unsigned power, tactile_value *value) {
  uint64_t bits = tactile_read_uint(r, power);
  uint32_t bits32 = (uint32_t)bits;
  float single;
  value->form = TACTILE_FORM_NUMBER;
  memcpy(&single, &bits32, 4);
  memcpy(&value->number, &bits, 8);
  if (power == 2) value->number = (double)single;
}

/** Read an integer; one from 2^63 is a number. */
static inline void tactile_next_integer(tactile_reader *r, unsigned code, tactile_value *value) {
  unsigned power = code & 3;
  uint64_t bits = tactile_read_uint(r, power);
  uint64_t sign = (uint64_t)1 << ((8u << power) - 1);
  bool is_signed = code >= 0xd0;
  value->form = is_signed || bits >> 63 == 0 ? TACTILE_FORM_INTEGER : TACTILE_FORM_NUMBER;
  value->number = (double)bits;
  if (is_signed && (bits & sign) != 0) {
    value->integer = -(int64_t)(sign - 1 - (bits - sign)) - 1;
  } else {
    value->integer = (int64_t)(bits & INT64_MAX);
  }
}

/** Read a number, text or other scalar, or the head of a list or map. */
static inline tactile_value tactile_next(tactile_reader *r) {
  tactile_value value = {TACTILE_FORM_EXTENSION, 0, 0.0, NULL, 0};
  unsigned code = (unsigned)tactile_read_uint(r, 0);
  if (code < 0x80 || code >= 0xe0) {
    value.form = TACTILE_FORM_INTEGER;
    value.integer = code < 0x80 ? (int64_t)code : (int64_t)code - 0x100;
  } else if (code < 0xa0) {
    value.form = code < 0x90 ? TACTILE_FORM_MAP : TACTILE_FORM_LIST;
    value.count = code & 15;
  } else if (code < 0xc0) {
    value.form = TACTILE_FORM_TEXT;
    value.count = code & 31;
  } else if (code == 0xc0) {
    value.form = TACTILE_FORM_NIL;
  } else if (code == 0xc1) {
    tactile_fail(r, TACTILE_MALFORMED);
  } else if (code < 0xc4) {
    value.form = TACTILE_FORM_BOOLEAN;
    value.integer = code & 1;
  } else if (code < 0xc7) {
    value.form = TACTILE_FORM_BYTES;
    value.count = (size_t)tactile_read_uint(r, code - 0xc4);
  } else if (code < 0xca) {
    value.count = (size_t)tactile_read_uint(r, code - 0xc7);
    tactile_take(r, 1);
  } else if (code < 0xcc) {
    tactile_next_number(r, code - 0xca + 2, &value);
  } else if (code < 0xd4) {
    tactile_next_integer(r, code, &value);
  } else if (code < 0xd9) {
    value.count = ((size_t)1 << (code - 0xd4)) + 1;
  } else if (code < 0xdc) {
    value.form = TACTILE_FORM_TEXT;
    value.count = (size_t)tactile_read_uint(r, code - 0xd9);
  } else {
    value.form = code < 0xde ? TACTILE_FORM_LIST : TACTILE_FORM_MAP;
    value.count = (size_t)tactile_read_uint(r, 1 + (code & 1));
  }
  if (value.form != TACTILE_FORM_LIST && value.form != TACTILE_FORM_MAP) {
    value.data = tactile_take(r, value.count);
  } else if (value.count > (r->size - r->at) / (value.form == TACTILE_FORM_MAP ? 2 : 1)) {
    tactile_fail(r, TACTILE_MALFORMED);
  }
  return value;
}

/** Pass over a value, however deep; each value that is due needs a byte at least. */
static inline void tactile_skip(tactile_reader *r) {
  size_t due = 1;
  while (due > 0 && r->status == TACTILE_OK) {
    tactile_value value = tactile_next(r);
    due--;
    if (value.form == TACTILE_FORM_LIST) due += value.count;
    if (value.form == TACTILE_FORM_MAP) due += 2 * value.count;
    if (due > r->size - r->at) tactile_fail(r, TACTILE_MALFORMED);
  }
}

/** Read a value that must be of a form. */
static inline tactile_value tactile_expect(tactile_reader *r, tactile_form form) {
  tactile_value value = tactile_next(r);
  if (value.form != form) tactile_fail(r, TACTILE_INVALID);
  if (r->status != TACTILE_OK) value.count = 0;
  return value;
}

/** Pass over a null, and return whether there was one. */
static inline bool tactile_read_nil(tactile_reader *r) {
  if (r->status != TACTILE_OK || r->at == r->size || r->data[r->at] != 0xc0) return false;
  r->at++;
  return true;
}

static inline void tactile_read_text(tactile_reader *r, tactile_text *value) {
  tactile_value text = tactile_expect(r, TACTILE_FORM_TEXT);
  value->data = (const char *)text.data;
  value->size = text.count;
}

static inline void tactile_read_bytes(tactile_reader *r, tactile_bytes *value) {
  tactile_value bytes = tactile_expect(r, TACTILE_FORM_BYTES);
  value->data = bytes.data;
  value->size = bytes.count;
}

static inline double tactile_read_number(tactile_reader *r) {
  tactile_value value = tactile_next(r);
  if (value.form == TACTILE_FORM_INTEGER) return (double)value.integer;
  if (value.form != TACTILE_FORM_NUMBER) tactile_fail(r, TACTILE_INVALID);
  return value.number;
}

/** Read one of the names of an enumeration; 0 if it is another. */
static inline void tactile_read_enumeration(tactile_reader *r, const tactile_shape *shape,
                                            void *value) {
  tactile_text text;
  int number = 0;
  uint8_t byte;
  tactile_read_text(r, &text);
  for (int i = 1; shape->names[i] != NULL; i++) {
    if (tactile_text_is(text, shape->names[i])) number = i;
  }
  byte = (uint8_t)number;
  /* Some compilers make enumerations as small as possible. */
  memcpy(value, shape->size == 1 ? (const void *)&byte : (const void *)&number, shape->size);
}

/** Allocate an array in the memory for lists; NULL if it is empty or does not fit. */
static inline void *tactile_allocate(tactile_reader *r, size_t count, size_t size) {
  union aligned {
    double number;
    int64_t integer;
    void *pointer;
  };
  size_t gap = (size_t)(0 - ((uintptr_t)r->memory + r->used)) % sizeof(union aligned);
  size_t left = r->room - r->used;
  if (count == 0) return NULL;
  if (gap > left || count > (left - gap) / size) {
    tactile_fail(r, TACTILE_NO_MEMORY);
    return NULL;
  }
  r->used += gap + count * size;
  return r->memory + (r->used - count * size);
}

/** Return the field `type` of a message after all of it has been read. */
static inline tactile_text tactile_read_tag(tactile_reader *r) {
  tactile_text tag = {NULL, 0};
  size_t count = tactile_expect(r, TACTILE_FORM_MAP).count;
  for (; count > 0 && r->status == TACTILE_OK; count--) {
    tactile_text key = {NULL, 0};
    tactile_read_text(r, &key);
    if (tactile_text_is(key, "type")) {
      tactile_read_text(r, &tag);
    } else {
      tactile_skip(r);
    }
  }
  if (r->at < r->size) tactile_fail(r, TACTILE_MALFORMED);
  if (tag.size == 0) tactile_fail(r, TACTILE_INVALID);
  return tag;
}

static inline void tactile_read_value(tactile_reader *r, const tactile_shape *shape, void *value);

/** Read a list or map into an array. */
static inline void tactile_read_array(tactile_reader *r, const tactile_shape *shape, void *value) {
  size_t size = shape->of->size;
  size_t count = tactile_expect(r, shape->form).count;
  char *items = (char *)tactile_allocate(r, count, size);
  tactile_array array;
  for (size_t i = 0; i < count && r->status == TACTILE_OK; i++) {
    tactile_read_value(r, shape->of, items + i * size);
  }
  array.items = items;
  array.count = count;
  memcpy(value, &array, sizeof array);
}

/** Read a field; a null clears its flag if it may be null. */
static inline void tactile_read_field(tactile_reader *r, const tactile_field *field, char *m) {
  bool present = field->flag == TACTILE_NO_FLAG || field->initial != 0 || !tactile_read_nil(r);
  if (present) tactile_read_value(r, field->shape, m + field->place);
  if (field->flag != TACTILE_NO_FLAG) *(bool *)(void *)(m + field->flag) = present;
}

static inline void tactile_set_default(const tactile_field *field, char *m) {
  void *value = m + field->place;
  if (field->initial == 0) return;
  if (field->shape->form == TACTILE_FORM_BOOLEAN) *(bool *)value = true;
  if (field->shape->form == TACTILE_FORM_INTEGER) *(int64_t *)value = (int64_t)field->initial;
  if (field->shape->form == TACTILE_FORM_NUMBER) *(double *)value = field->initial;
}

static inline void tactile_read_structure(tactile_reader *r, const tactile_shape *shape, char *m) {
  size_t count = tactile_expect(r, TACTILE_FORM_MAP).count;
  uint32_t seen = 0;
  memset(m, 0, shape->size);
  for (size_t i = 0; i < shape->count; i++) tactile_set_default(&shape->fields[i], m);
  for (; count > 0 && r->status == TACTILE_OK; count--) {
    tactile_text key;
    size_t i = 0;
    tactile_read_text(r, &key);
    while (i < shape->count && !tactile_text_is(key, shape->fields[i].name)) i++;
    if (i < shape->count) {
      tactile_read_field(r, &shape->fields[i], m);
      seen |= (uint32_t)1 << i;
    } else {
      tactile_skip(r);
    }
  }
  for (size_t i = 0; i < shape->count; i++) {
    bool missing = shape->fields[i].rule == TACTILE_REQUIRED && (seen >> i & 1) == 0;
    if (missing) tactile_fail(r, TACTILE_INVALID);
  }
}

/** Read fields in their order, all of which must be there. */
static inline void tactile_read_tuple(tactile_reader *r, const tactile_shape *shape, char *m) {
  for (size_t i = 0; i < shape->count; i++) tactile_read_field(r, &shape->fields[i], m);
}

static inline void tactile_read_value(tactile_reader *r, const tactile_shape *shape, void *value) {
  switch (shape->form) {
    case TACTILE_FORM_BOOLEAN:
      *(bool *)value = tactile_expect(r, TACTILE_FORM_BOOLEAN).integer != 0;
      break;
    case TACTILE_FORM_INTEGER:
      *(int64_t *)value = tactile_expect(r, TACTILE_FORM_INTEGER).integer;
      break;
    case TACTILE_FORM_NUMBER: *(double *)value = tactile_read_number(r); break;
    case TACTILE_FORM_TEXT: tactile_read_text(r, (tactile_text *)value); break;
    case TACTILE_FORM_BYTES: tactile_read_bytes(r, (tactile_bytes *)value); break;
    case TACTILE_FORM_ENUMERATION: tactile_read_enumeration(r, shape, value); break;
    case TACTILE_FORM_STRUCTURE: tactile_read_structure(r, shape, (char *)value); break;
    case TACTILE_FORM_TUPLE:
      if (tactile_expect(r, TACTILE_FORM_LIST).count != shape->count) {
        tactile_fail(r, TACTILE_INVALID);
      }
      tactile_read_tuple(r, shape, (char *)value);
      break;
    case TACTILE_FORM_ENTRY: tactile_read_tuple(r, shape, (char *)value); break;
    default: tactile_read_array(r, shape, value);
  }
}

/**
 * Decode a message of the server. Its texts point to `data`, and its lists into `memory`, of which
 * 16 bytes for each byte of the message suffice. `answer->type` is TACTILE_TYPE_UNKNOWN if the
 * outcome is not TACTILE_OK.
 */
static inline tactile_status tactile_decode(const uint8_t *data, size_t size,
                                            tactile_answer *answer, void *memory, size_t room) {
  static const tactile_shape *const shapes[] = {
      &tactile_shape_welcome,
      &tactile_shape_textures,
      &tactile_shape_texture_picture,
      &tactile_shape_effects,
      &tactile_shape_done,
      &tactile_shape_appended,
      &tactile_shape_pong,
      &tactile_shape_stats,
      &tactile_shape_failure,
      &tactile_shape_event,
      &tactile_shape_onset,
      &tactile_shape_telemetry};
  tactile_reader r = {data, size, 0, (uint8_t *)memory, room, 0, TACTILE_OK};
  tactile_text tag = tactile_read_tag(&r);
  size_t count = sizeof shapes / sizeof *shapes;
  size_t i = 0;
  memset(answer, 0, sizeof *answer);
  while (i < count && !tactile_text_is(tag, shapes[i]->names[0])) i++;
  if (i == count) tactile_fail(&r, TACTILE_UNKNOWN_TYPE);
  if (r.status != TACTILE_OK) return r.status;
  r.at = 0;
  tactile_read_value(&r, shapes[i], &answer->as);
  if (r.status == TACTILE_OK) answer->type = (tactile_type)(i + 1);
  return r.status;
}

#endif
