/**
 * Shapes of what a server sends, by which the client checks it; written by
 * `python -m clients.generate` from the JSON Schema of tactile/messages.py.
 */
/** Shape of each message by its type. */
export const ANSWERS = {
    welcome: "Welcome",
    textures: "Textures",
    texture_picture: "TexturePicture",
    effects: "Effects",
    done: "Done",
    appended: "AppendedReply",
    pong: "Pong",
    stats: "StatsReply",
    failure: "Failure",
    event: "EventMessage",
    onset: "OnsetMessage",
    telemetry: "TelemetryMessage",
};
/** Shapes by name. */
export const SHAPES = {
    Welcome: {
        required: {
            server: "string",
            version: "integer",
            session: "string",
            displays: { list: { shape: "DisplayDescription" } },
            may_arm: "boolean",
            time_us: "integer",
        },
        optional: {
            id: { anyOf: ["integer", "null"] },
            roles: { list: "string" },
            largest_message: "integer",
            messages_per_second: "integer",
        },
    },
    Textures: {
        required: {
            textures: { list: { shape: "TextureInfo" } },
        },
        optional: {
            id: { anyOf: ["integer", "null"] },
        },
    },
    TexturePicture: {
        required: {
            lowest_um: "number",
            highest_um: "number",
            pixels: "bytes",
        },
        optional: {
            id: { anyOf: ["integer", "null"] },
        },
    },
    Effects: {
        required: {
            effects: { list: { shape: "EffectInfo" } },
        },
        optional: {
            id: { anyOf: ["integer", "null"] },
        },
    },
    Done: {
        required: {},
        optional: {
            id: { anyOf: ["integer", "null"] },
            estops: { map: "integer" },
        },
    },
    AppendedReply: {
        required: {
            samples_consumed: "integer",
            buffered_ms: "number",
        },
        optional: {
            id: { anyOf: ["integer", "null"] },
        },
    },
    Pong: {
        required: {
            time_us: "integer",
            server_time_us: "integer",
        },
        optional: {
            id: { anyOf: ["integer", "null"] },
        },
    },
    StatsReply: {
        required: {
            display: "string",
            state: "string",
            link: "string",
            detail: "string",
            touching: "boolean",
            owner: "boolean",
            latency_ms: { anyOf: ["number", "null"] },
            counters: { map: "integer" },
        },
        optional: {
            id: { anyOf: ["integer", "null"] },
            estop: "integer",
            put_out_share: { anyOf: ["number", "null"] },
            lead_ms: { anyOf: ["number", "null"] },
        },
    },
    Failure: {
        required: {
            code: "string",
            message: "string",
        },
        optional: {
            id: { anyOf: ["integer", "null"] },
            field: "string",
        },
    },
    EventMessage: {
        required: {
            display: "string",
            kind: "string",
        },
        optional: {
            detail: "string",
            estop: "integer",
            contactors: { list: "integer" },
        },
    },
    OnsetMessage: {
        required: {
            display: "string",
            number: "integer",
            at_us: "integer",
            onset_us: { anyOf: ["number", "null"] },
            uncertainty_us: { anyOf: ["number", "null"] },
        },
        optional: {
            reason: "string",
            marker: "integer",
            client: { anyOf: ["integer", "null"] },
        },
    },
    TelemetryMessage: {
        required: {
            display: "string",
            time_us: "integer",
            state: "string",
            position_mm: { tuple: ["number", "number"] },
            velocity_mm_s: { tuple: ["number", "number"] },
            normal_force_n: "number",
            shear_um: { anyOf: [{ list: "number" }, "null"] },
            drive_v: { list: "number" },
            counters: { map: "integer" },
        },
        optional: {
            put_out_share: { anyOf: ["number", "null"] },
            finger: { anyOf: [{ shape: "TelemetryFinger" }, "null"] },
            trace: { anyOf: [{ shape: "TelemetryTrace" }, "null"] },
            played: { anyOf: [{ shape: "TelemetryTrace" }, "null"] },
            samples: { anyOf: [{ shape: "TelemetrySamples" }, "null"] },
        },
    },
    DisplayDescription: {
        required: {
            name: "string",
            contactors_mm: { list: { tuple: ["number", "number"] } },
            shear_direction_deg: { list: "number" },
            sample_rate_hz: "number",
            voltage_limit_v: "number",
            waveforms: "boolean",
            latency_ms: "number",
        },
        optional: {
            estop: "integer",
            latest_estop: "integer",
            follows: "boolean",
            threshold_um: { list: { tuple: ["number", "number"] } },
            marker_lines: "integer",
        },
    },
    TextureInfo: {
        required: {
            name: "string",
            category: "string",
            description: "string",
            provenance: "string",
        },
        optional: {},
    },
    EffectInfo: {
        required: {
            name: "string",
            description: "string",
            seconds: "number",
        },
        optional: {},
    },
    TelemetryFinger: {
        required: {
            touching: { list: "boolean" },
            stiffness_n_m: { list: "number" },
            equalizer_error_db: { list: "number" },
            explained: { list: "boolean" },
            guarded: { list: "boolean" },
        },
        optional: {},
    },
    TelemetryTrace: {
        required: {
            contactor: "integer",
            sample_rate_hz: "number",
            first: "integer",
            shear_um: "bytes",
        },
        optional: {},
    },
    TelemetrySamples: {
        required: {
            first: "integer",
            sample_rate_hz: "number",
            block_samples: "integer",
            times_us: "bytes",
            uncertainty_us: { anyOf: ["number", "null"] },
            finger_times_us: "bytes",
            position_mm: "bytes",
            velocity_mm_s: "bytes",
            normal_force_n: "bytes",
            touching: { list: "boolean" },
            shear_um: { anyOf: ["bytes", "null"] },
            drive_v: { anyOf: ["bytes", "null"] },
        },
        optional: {},
    },
};
