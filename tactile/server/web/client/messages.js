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
