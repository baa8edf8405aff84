/* Messages, codes and states of the protocol; written by generate.py from schema.toml.
 *
 * SPEC.md defines their meaning. tp_X_encode writes a payload and returns its size, or 0
 * if it does not fit. tp_X_decode decodes a payload: a missing tail reads as 0 and an
 * unknown tail is ignored. It returns false for a payload that is shorter than the head
 * of a message with a body. Bodies are pointers into the payload.
 */
#ifndef TACTILE_MESSAGES_H
#define TACTILE_MESSAGES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define TP_MAJOR 1u
#define TP_MINOR 4u
#define TP_SCHEMA_CRC 0xE2066801u
#define TP_TABLE_STAYS 0x40u
#define TP_TABLE_REFUSED 0x80u
#define TP_WATCHDOG_MS 150u
#define TP_HEARTBEAT_MS 50u
#define TP_FADE_MS 20u
#define TP_VALID_MS 50u
#define TP_FRAGMENT_TIMEOUT_MS 20u
#define TP_INPUT_CLOSED_MS 50u
#define TP_UNGUARDED_MOST_UV 0x3938700u
#define TP_START_AHEAD_MS 10000u
#define TP_PACKET_MAX 4096u
#define TP_FULL_SCALE_CODE 32767u
#define TP_CARRIERS_MAX 64u
#define TP_CAN_PREFIX 0x1D0B0000u
#define TP_LAGS 16u
#define TP_CORRELATED_MOST 12u
#define TP_EXPONENT_MOST 32u
#define TP_GUARD_TAPS 13u
#define TP_GUARD_BLOCK 8u
#define TP_GUARD_BLOCKS 5u
#define TP_GUARD_LEAST 1024u
#define TP_MARKER_LINES_MOST 8u
#define TP_MARKS_MOST 8u

enum {
    TP_FLAG_ACK_REQUEST = 32,
    TP_FLAG_INCOMPATIBLE = 24,
    TP_FLAG_COMPATIBLE = 7
};

enum {
    TP_STATE_IDLE = 0,
    TP_STATE_ARMED = 1,
    TP_STATE_RUNNING = 2,
    TP_STATE_RAMPDOWN = 3,
    TP_STATE_SAFE = 4,
    TP_STATE_FAULT = 5,
    TP_STATE_ESTOP = 6
};

enum {
    TP_PHASE_STILL = 0,
    TP_PHASE_WAITING = 1,
    TP_PHASE_PLAYING = 2,
    TP_PHASE_STARVED = 3
};

enum {
    TP_NAK_UNKNOWN_TYPE = 1,
    TP_NAK_VERSION = 2,
    TP_NAK_UNSUPPORTED = 3,
    TP_NAK_LENGTH = 4,
    TP_NAK_SESSION = 5,
    TP_NAK_BUSY = 6,
    TP_NAK_STATE = 7,
    TP_NAK_NOT_ARMED = 8,
    TP_NAK_FAULT = 9,
    TP_NAK_ESTOP = 10,
    TP_NAK_RANGE = 11,
    TP_NAK_CHANNEL = 12,
    TP_NAK_FORMAT = 13,
    TP_NAK_PARAMETER = 14,
    TP_NAK_READ_ONLY = 15,
    TP_NAK_TIME = 16,
    TP_NAK_CARRIERS = 17,
    TP_NAK_INPUT_OPEN = 18
};

enum {
    TP_MODE_PCM = 0,
    TP_MODE_SPECTRUM = 1
};

enum {
    TP_SAMPLE_FORMAT_PCM16 = 0,
    TP_SAMPLE_FORMAT_PCM12 = 1,
    TP_SAMPLE_FORMAT_BFP8 = 2,
    TP_SAMPLE_FORMAT_SPECTRUM8 = 3
};

enum {
    TP_FAULT_NONE = 0,
    TP_FAULT_OVERCURRENT = 1,
    TP_FAULT_OVERTEMPERATURE = 2,
    TP_FAULT_UNDERVOLTAGE = 3,
    TP_FAULT_HARDWARE = 4
};

enum {
    TP_PARAMETER_NODE = 1,
    TP_PARAMETER_PULSE_MS = 2,
    TP_PARAMETER_SENSE_MS = 3,
    TP_PARAMETER_LOG_LEVEL = 4,
    TP_PARAMETER_UPTIME_S = 5,
    TP_PARAMETER_HIGH_VOLTAGE_MV = 6,
    TP_PARAMETER_TEMPERATURE_MK = 7,
    TP_PARAMETER_CORRELATION_MS = 8,
    TP_PARAMETER_SENSE_RANGE_UA = 9
};

enum {
    TP_LOG_LEVEL_DEBUG = 0,
    TP_LOG_LEVEL_INFO = 1,
    TP_LOG_LEVEL_WARNING = 2,
    TP_LOG_LEVEL_ERROR = 3,
    TP_LOG_LEVEL_OFF = 4
};

enum {
    TP_FEATURE_SENSES = 1,
    TP_FEATURE_ZERO_ORDER_HOLD = 2,
    TP_FEATURE_ESTOP_INPUT = 4,
    TP_FEATURE_CORRELATES = 8,
    TP_FEATURE_GUARDS = 16
};

enum {
    TP_ESTOP_REASON_INPUT = 255
};

enum {
    TP_INPUT_ESTOP_OPEN = 1
};

enum {
    TP_WINDOW_CLIPPED = 1,
    TP_WINDOW_GUARDED = 2
};

enum {
    TP_GUARD_FLAG_ARMED = 1,
    TP_GUARD_FLAG_RELEASE = 2
};

enum {
    TP_GUARD_REASON_NONE = 0,
    TP_GUARD_REASON_RESIDUAL = 1,
    TP_GUARD_REASON_LOST = 2
};

enum {
    TP_CAN_CLASS_ESTOP = 0,
    TP_CAN_CLASS_PROMPT = 1,
    TP_CAN_CLASS_PULSE = 2,
    TP_CAN_CLASS_STREAM = 3,
    TP_CAN_CLASS_REQUEST = 4,
    TP_CAN_CLASS_RESPONSE = 5,
    TP_CAN_CLASS_BULK = 6
};

/* State table of section 6: an entry per state. */
#define TP_TABLE_HELLO_OTHER {0x40u, 0x86u, 0x86u, 0x86u, 0x40u, 0x40u, 0x40u}
#define TP_TABLE_ARM {0x01u, 0x01u, 0x87u, 0x87u, 0x01u, 0x89u, 0x8Au}
#define TP_TABLE_START {0x88u, 0x02u, 0x87u, 0x87u, 0x88u, 0x89u, 0x8Au}
#define TP_TABLE_STOP {0x40u, 0x40u, 0x0Bu, 0x40u, 0x40u, 0x40u, 0x40u}
#define TP_TABLE_DISARM {0x40u, 0x00u, 0x03u, 0x03u, 0x00u, 0x40u, 0x40u}
#define TP_TABLE_ESTOP {0x06u, 0x06u, 0x06u, 0x06u, 0x06u, 0x06u, 0x40u}
#define TP_TABLE_CLEAR_FAULT {0x40u, 0x40u, 0x40u, 0x40u, 0x40u, 0x00u, 0x00u}
#define TP_TABLE_LIMITS {0x40u, 0x40u, 0x87u, 0x87u, 0x40u, 0x40u, 0x40u}
#define TP_TABLE_CARRIERS {0x40u, 0x40u, 0x87u, 0x87u, 0x40u, 0x40u, 0x40u}
#define TP_TABLE_WATCHDOG {0x40u, 0x04u, 0x23u, 0x23u, 0x40u, 0x40u, 0x40u}
#define TP_TABLE_FAULT {0x05u, 0x05u, 0x05u, 0x05u, 0x05u, 0x40u, 0x40u}
#define TP_TABLE_ESTOP_INPUT {0x06u, 0x06u, 0x06u, 0x06u, 0x06u, 0x06u, 0x40u}

static inline void tp_put_le(uint8_t *out, uint64_t value, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        out[i] = (uint8_t)(value >> (8u * i));
    }
}

/* Bytes beyond the end read as 0. */
static inline uint64_t tp_get_le(const uint8_t *in, size_t length, size_t at, size_t size)
{
    uint64_t value = 0;
    for (size_t i = 0; i < size && at + i < length; i++) {
        value |= (uint64_t)in[at + i] << (8u * i);
    }
    return value;
}

#define TP_HELLO 0x01u
#define TP_HELLO_SIZE 8u
typedef struct {
    uint16_t session;
    uint8_t major;
    uint8_t minor;
    uint32_t schema;
} tp_hello;

static inline size_t tp_hello_encode(const tp_hello *m, uint8_t *out, size_t room)
{
    if (room < TP_HELLO_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->major, 1);
    tp_put_le(out + 3, (uint64_t)m->minor, 1);
    tp_put_le(out + 4, (uint64_t)m->schema, 4);
    return 8;
}

static inline bool tp_hello_decode(tp_hello *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->major = (uint8_t)tp_get_le(in, length, 2, 1);
    m->minor = (uint8_t)tp_get_le(in, length, 3, 1);
    m->schema = (uint32_t)tp_get_le(in, length, 4, 4);
    return true;
}

#define TP_TIME 0x02u
#define TP_TIME_SIZE 8u
typedef struct {
    uint64_t host_time;
} tp_time;

static inline size_t tp_time_encode(const tp_time *m, uint8_t *out, size_t room)
{
    if (room < TP_TIME_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->host_time, 8);
    return 8;
}

static inline bool tp_time_decode(tp_time *m, const uint8_t *in, size_t length)
{
    m->host_time = (uint64_t)tp_get_le(in, length, 0, 8);
    return true;
}

#define TP_SYNC 0x03u
#define TP_SYNC_SIZE 1u
typedef struct {
    uint8_t index;
} tp_sync;

static inline size_t tp_sync_encode(const tp_sync *m, uint8_t *out, size_t room)
{
    if (room < TP_SYNC_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->index, 1);
    return 1;
}

static inline bool tp_sync_decode(tp_sync *m, const uint8_t *in, size_t length)
{
    m->index = (uint8_t)tp_get_le(in, length, 0, 1);
    return true;
}

#define TP_START 0x04u
#define TP_START_SIZE 15u
typedef struct {
    uint16_t session;
    uint32_t position;
    uint8_t delay_ms;
    uint64_t time;
} tp_start;

static inline size_t tp_start_encode(const tp_start *m, uint8_t *out, size_t room)
{
    if (room < TP_START_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->position, 4);
    tp_put_le(out + 6, (uint64_t)m->delay_ms, 1);
    tp_put_le(out + 7, (uint64_t)m->time, 8);
    return 15;
}

static inline bool tp_start_decode(tp_start *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->position = (uint32_t)tp_get_le(in, length, 2, 4);
    m->delay_ms = (uint8_t)tp_get_le(in, length, 6, 1);
    m->time = (uint64_t)tp_get_le(in, length, 7, 8);
    return true;
}

#define TP_STOP 0x05u
#define TP_STOP_SIZE 3u
typedef struct {
    uint16_t session;
    uint8_t quick;
} tp_stop;

static inline size_t tp_stop_encode(const tp_stop *m, uint8_t *out, size_t room)
{
    if (room < TP_STOP_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->quick, 1);
    return 3;
}

static inline bool tp_stop_decode(tp_stop *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->quick = (uint8_t)tp_get_le(in, length, 2, 1);
    return true;
}

#define TP_ARM 0x06u
#define TP_ARM_SIZE 7u
typedef struct {
    uint16_t session;
    uint8_t mode;
    uint32_t sample_rate_hz;
} tp_arm;

static inline size_t tp_arm_encode(const tp_arm *m, uint8_t *out, size_t room)
{
    if (room < TP_ARM_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->mode, 1);
    tp_put_le(out + 3, (uint64_t)m->sample_rate_hz, 4);
    return 7;
}

static inline bool tp_arm_decode(tp_arm *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->mode = (uint8_t)tp_get_le(in, length, 2, 1);
    m->sample_rate_hz = (uint32_t)tp_get_le(in, length, 3, 4);
    return true;
}

#define TP_DISARM 0x07u
#define TP_DISARM_SIZE 2u
typedef struct {
    uint16_t session;
} tp_disarm;

static inline size_t tp_disarm_encode(const tp_disarm *m, uint8_t *out, size_t room)
{
    if (room < TP_DISARM_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    return 2;
}

static inline bool tp_disarm_decode(tp_disarm *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    return true;
}

#define TP_ESTOP 0x08u
#define TP_ESTOP_SIZE 1u
typedef struct {
    uint8_t reason;
} tp_estop;

static inline size_t tp_estop_encode(const tp_estop *m, uint8_t *out, size_t room)
{
    if (room < TP_ESTOP_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->reason, 1);
    return 1;
}

static inline bool tp_estop_decode(tp_estop *m, const uint8_t *in, size_t length)
{
    m->reason = (uint8_t)tp_get_le(in, length, 0, 1);
    return true;
}

#define TP_CLEAR_FAULT 0x09u
#define TP_CLEAR_FAULT_SIZE 6u
typedef struct {
    uint16_t session;
    uint32_t trips;
} tp_clear_fault;

static inline size_t tp_clear_fault_encode(const tp_clear_fault *m, uint8_t *out, size_t room)
{
    if (room < TP_CLEAR_FAULT_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->trips, 4);
    return 6;
}

static inline bool tp_clear_fault_decode(tp_clear_fault *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->trips = (uint32_t)tp_get_le(in, length, 2, 4);
    return true;
}

#define TP_HEARTBEAT 0x0Au
#define TP_HEARTBEAT_SIZE 2u
typedef struct {
    uint16_t session;
} tp_heartbeat;

static inline size_t tp_heartbeat_encode(const tp_heartbeat *m, uint8_t *out, size_t room)
{
    if (room < TP_HEARTBEAT_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    return 2;
}

static inline bool tp_heartbeat_decode(tp_heartbeat *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    return true;
}

#define TP_LIMITS 0x0Bu
#define TP_LIMITS_SIZE 14u
typedef struct {
    uint16_t session;
    uint32_t voltage_uv;
    uint32_t slew_v_per_s;
    uint32_t fade_us;
} tp_limits;

static inline size_t tp_limits_encode(const tp_limits *m, uint8_t *out, size_t room)
{
    if (room < TP_LIMITS_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->voltage_uv, 4);
    tp_put_le(out + 6, (uint64_t)m->slew_v_per_s, 4);
    tp_put_le(out + 10, (uint64_t)m->fade_us, 4);
    return 14;
}

static inline bool tp_limits_decode(tp_limits *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->voltage_uv = (uint32_t)tp_get_le(in, length, 2, 4);
    m->slew_v_per_s = (uint32_t)tp_get_le(in, length, 6, 4);
    m->fade_us = (uint32_t)tp_get_le(in, length, 10, 4);
    return true;
}

#define TP_GET 0x0Cu
#define TP_GET_SIZE 2u
typedef struct {
    uint16_t parameter;
} tp_get;

static inline size_t tp_get_encode(const tp_get *m, uint8_t *out, size_t room)
{
    if (room < TP_GET_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->parameter, 2);
    return 2;
}

static inline bool tp_get_decode(tp_get *m, const uint8_t *in, size_t length)
{
    m->parameter = (uint16_t)tp_get_le(in, length, 0, 2);
    return true;
}

#define TP_SET 0x0Du
#define TP_SET_SIZE 8u
typedef struct {
    uint16_t session;
    uint16_t parameter;
    uint32_t value;
} tp_set;

static inline size_t tp_set_encode(const tp_set *m, uint8_t *out, size_t room)
{
    if (room < TP_SET_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->parameter, 2);
    tp_put_le(out + 4, (uint64_t)m->value, 4);
    return 8;
}

static inline bool tp_set_decode(tp_set *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->parameter = (uint16_t)tp_get_le(in, length, 2, 2);
    m->value = (uint32_t)tp_get_le(in, length, 4, 4);
    return true;
}

#define TP_IDENTIFY 0x0Eu
#define TP_IDENTIFY_SIZE 1u
typedef struct {
    uint8_t seconds;
} tp_identify;

static inline size_t tp_identify_encode(const tp_identify *m, uint8_t *out, size_t room)
{
    if (room < TP_IDENTIFY_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->seconds, 1);
    return 1;
}

static inline bool tp_identify_decode(tp_identify *m, const uint8_t *in, size_t length)
{
    m->seconds = (uint8_t)tp_get_le(in, length, 0, 1);
    return true;
}

#define TP_POLL 0x0Fu
#define TP_POLL_SIZE 0u
typedef struct {
    uint8_t nothing;
} tp_poll;

static inline size_t tp_poll_encode(const tp_poll *m, uint8_t *out, size_t room)
{
    (void)m;
    (void)out;
    (void)room;
    return 0;
}

static inline bool tp_poll_decode(tp_poll *m, const uint8_t *in, size_t length)
{
    (void)in;
    (void)length;
    m->nothing = 0;
    return true;
}

#define TP_PCM 0x10u
#define TP_PCM_SIZE 10u
typedef struct {
    uint32_t position;
    uint16_t session;
    uint8_t first_channel;
    uint8_t channels;
    uint8_t format;
    uint8_t samples;
    const uint8_t *data;
    size_t data_size;
} tp_pcm;

static inline size_t tp_pcm_encode(const tp_pcm *m, uint8_t *out, size_t room)
{
    if (room < TP_PCM_SIZE || room - TP_PCM_SIZE < m->data_size) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->position, 4);
    tp_put_le(out + 4, (uint64_t)m->session, 2);
    tp_put_le(out + 6, (uint64_t)m->first_channel, 1);
    tp_put_le(out + 7, (uint64_t)m->channels, 1);
    tp_put_le(out + 8, (uint64_t)m->format, 1);
    tp_put_le(out + 9, (uint64_t)m->samples, 1);
    if (m->data_size > 0) {
        memcpy(out + TP_PCM_SIZE, m->data, m->data_size);
    }
    return TP_PCM_SIZE + m->data_size;
}

static inline bool tp_pcm_decode(tp_pcm *m, const uint8_t *in, size_t length)
{
    if (length < TP_PCM_SIZE) {
        return false;
    }
    m->position = (uint32_t)tp_get_le(in, length, 0, 4);
    m->session = (uint16_t)tp_get_le(in, length, 4, 2);
    m->first_channel = (uint8_t)tp_get_le(in, length, 6, 1);
    m->channels = (uint8_t)tp_get_le(in, length, 7, 1);
    m->format = (uint8_t)tp_get_le(in, length, 8, 1);
    m->samples = (uint8_t)tp_get_le(in, length, 9, 1);
    m->data = in + 10;
    m->data_size = length - 10;
    return true;
}

#define TP_CARRIERS 0x11u
#define TP_CARRIERS_SIZE 3u
typedef struct {
    uint16_t session;
    uint8_t count;
    const uint8_t *increments;
    size_t increments_size;
} tp_carriers;

static inline size_t tp_carriers_encode(const tp_carriers *m, uint8_t *out, size_t room)
{
    if (room < TP_CARRIERS_SIZE || room - TP_CARRIERS_SIZE < m->increments_size) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->count, 1);
    if (m->increments_size > 0) {
        memcpy(out + TP_CARRIERS_SIZE, m->increments, m->increments_size);
    }
    return TP_CARRIERS_SIZE + m->increments_size;
}

static inline bool tp_carriers_decode(tp_carriers *m, const uint8_t *in, size_t length)
{
    if (length < TP_CARRIERS_SIZE) {
        return false;
    }
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->count = (uint8_t)tp_get_le(in, length, 2, 1);
    m->increments = in + 3;
    m->increments_size = length - 3;
    return true;
}

#define TP_SPECTRUM 0x12u
#define TP_SPECTRUM_SIZE 12u
typedef struct {
    uint32_t position;
    uint16_t session;
    uint16_t valid;
    uint8_t first_channel;
    uint8_t channels;
    uint8_t format;
    uint8_t carriers;
    const uint8_t *envelopes;
    size_t envelopes_size;
} tp_spectrum;

static inline size_t tp_spectrum_encode(const tp_spectrum *m, uint8_t *out, size_t room)
{
    if (room < TP_SPECTRUM_SIZE || room - TP_SPECTRUM_SIZE < m->envelopes_size) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->position, 4);
    tp_put_le(out + 4, (uint64_t)m->session, 2);
    tp_put_le(out + 6, (uint64_t)m->valid, 2);
    tp_put_le(out + 8, (uint64_t)m->first_channel, 1);
    tp_put_le(out + 9, (uint64_t)m->channels, 1);
    tp_put_le(out + 10, (uint64_t)m->format, 1);
    tp_put_le(out + 11, (uint64_t)m->carriers, 1);
    if (m->envelopes_size > 0) {
        memcpy(out + TP_SPECTRUM_SIZE, m->envelopes, m->envelopes_size);
    }
    return TP_SPECTRUM_SIZE + m->envelopes_size;
}

static inline bool tp_spectrum_decode(tp_spectrum *m, const uint8_t *in, size_t length)
{
    if (length < TP_SPECTRUM_SIZE) {
        return false;
    }
    m->position = (uint32_t)tp_get_le(in, length, 0, 4);
    m->session = (uint16_t)tp_get_le(in, length, 4, 2);
    m->valid = (uint16_t)tp_get_le(in, length, 6, 2);
    m->first_channel = (uint8_t)tp_get_le(in, length, 8, 1);
    m->channels = (uint8_t)tp_get_le(in, length, 9, 1);
    m->format = (uint8_t)tp_get_le(in, length, 10, 1);
    m->carriers = (uint8_t)tp_get_le(in, length, 11, 1);
    m->envelopes = in + 12;
    m->envelopes_size = length - 12;
    return true;
}

#define TP_GUARD 0x13u
#define TP_GUARD_SIZE 4u
typedef struct {
    uint16_t session;
    uint8_t first_channel;
    uint8_t channels;
    const uint8_t *entries;
    size_t entries_size;
} tp_guard;

static inline size_t tp_guard_encode(const tp_guard *m, uint8_t *out, size_t room)
{
    if (room < TP_GUARD_SIZE || room - TP_GUARD_SIZE < m->entries_size) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->first_channel, 1);
    tp_put_le(out + 3, (uint64_t)m->channels, 1);
    if (m->entries_size > 0) {
        memcpy(out + TP_GUARD_SIZE, m->entries, m->entries_size);
    }
    return TP_GUARD_SIZE + m->entries_size;
}

static inline bool tp_guard_decode(tp_guard *m, const uint8_t *in, size_t length)
{
    if (length < TP_GUARD_SIZE) {
        return false;
    }
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->first_channel = (uint8_t)tp_get_le(in, length, 2, 1);
    m->channels = (uint8_t)tp_get_le(in, length, 3, 1);
    m->entries = in + 4;
    m->entries_size = length - 4;
    return true;
}

#define TP_MARK 0x14u
#define TP_MARK_SIZE 9u
typedef struct {
    uint16_t session;
    uint32_t position;
    uint8_t code;
    uint16_t samples;
} tp_mark;

static inline size_t tp_mark_encode(const tp_mark *m, uint8_t *out, size_t room)
{
    if (room < TP_MARK_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->position, 4);
    tp_put_le(out + 6, (uint64_t)m->code, 1);
    tp_put_le(out + 7, (uint64_t)m->samples, 2);
    return 9;
}

static inline bool tp_mark_decode(tp_mark *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->position = (uint32_t)tp_get_le(in, length, 2, 4);
    m->code = (uint8_t)tp_get_le(in, length, 6, 1);
    m->samples = (uint16_t)tp_get_le(in, length, 7, 2);
    return true;
}

#define TP_ACK 0x40u
#define TP_ACK_SIZE 2u
typedef struct {
    uint8_t type;
    uint8_t seq;
} tp_ack;

static inline size_t tp_ack_encode(const tp_ack *m, uint8_t *out, size_t room)
{
    if (room < TP_ACK_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->type, 1);
    tp_put_le(out + 1, (uint64_t)m->seq, 1);
    return 2;
}

static inline bool tp_ack_decode(tp_ack *m, const uint8_t *in, size_t length)
{
    m->type = (uint8_t)tp_get_le(in, length, 0, 1);
    m->seq = (uint8_t)tp_get_le(in, length, 1, 1);
    return true;
}

#define TP_NAK 0x41u
#define TP_NAK_SIZE 8u
typedef struct {
    uint8_t type;
    uint8_t seq;
    uint8_t code;
    uint8_t state;
    uint32_t detail;
} tp_nak;

static inline size_t tp_nak_encode(const tp_nak *m, uint8_t *out, size_t room)
{
    if (room < TP_NAK_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->type, 1);
    tp_put_le(out + 1, (uint64_t)m->seq, 1);
    tp_put_le(out + 2, (uint64_t)m->code, 1);
    tp_put_le(out + 3, (uint64_t)m->state, 1);
    tp_put_le(out + 4, (uint64_t)m->detail, 4);
    return 8;
}

static inline bool tp_nak_decode(tp_nak *m, const uint8_t *in, size_t length)
{
    m->type = (uint8_t)tp_get_le(in, length, 0, 1);
    m->seq = (uint8_t)tp_get_le(in, length, 1, 1);
    m->code = (uint8_t)tp_get_le(in, length, 2, 1);
    m->state = (uint8_t)tp_get_le(in, length, 3, 1);
    m->detail = (uint32_t)tp_get_le(in, length, 4, 4);
    return true;
}

#define TP_CAPS 0x42u
#define TP_CAPS_SIZE 67u
typedef struct {
    uint16_t session;
    uint8_t major;
    uint8_t minor;
    uint32_t schema;
    uint8_t channels;
    uint8_t carriers;
    uint16_t formats;
    uint16_t features;
    uint16_t packet_limit;
    uint16_t fifo_samples;
    uint32_t tick_hz;
    uint32_t rate_min_hz;
    uint32_t rate_max_hz;
    uint32_t full_scale_uv;
    uint32_t voltage_limit_uv;
    uint32_t slew_limit_v_per_s;
    uint32_t fade_limit_us;
    uint32_t firmware;
    char name[16];
    uint8_t marker_lines;
} tp_caps;

static inline size_t tp_caps_encode(const tp_caps *m, uint8_t *out, size_t room)
{
    if (room < TP_CAPS_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->session, 2);
    tp_put_le(out + 2, (uint64_t)m->major, 1);
    tp_put_le(out + 3, (uint64_t)m->minor, 1);
    tp_put_le(out + 4, (uint64_t)m->schema, 4);
    tp_put_le(out + 8, (uint64_t)m->channels, 1);
    tp_put_le(out + 9, (uint64_t)m->carriers, 1);
    tp_put_le(out + 10, (uint64_t)m->formats, 2);
    tp_put_le(out + 12, (uint64_t)m->features, 2);
    tp_put_le(out + 14, (uint64_t)m->packet_limit, 2);
    tp_put_le(out + 16, (uint64_t)m->fifo_samples, 2);
    tp_put_le(out + 18, (uint64_t)m->tick_hz, 4);
    tp_put_le(out + 22, (uint64_t)m->rate_min_hz, 4);
    tp_put_le(out + 26, (uint64_t)m->rate_max_hz, 4);
    tp_put_le(out + 30, (uint64_t)m->full_scale_uv, 4);
    tp_put_le(out + 34, (uint64_t)m->voltage_limit_uv, 4);
    tp_put_le(out + 38, (uint64_t)m->slew_limit_v_per_s, 4);
    tp_put_le(out + 42, (uint64_t)m->fade_limit_us, 4);
    tp_put_le(out + 46, (uint64_t)m->firmware, 4);
    memcpy(out + 50, m->name, 16);
    tp_put_le(out + 66, (uint64_t)m->marker_lines, 1);
    return 67;
}

static inline bool tp_caps_decode(tp_caps *m, const uint8_t *in, size_t length)
{
    m->session = (uint16_t)tp_get_le(in, length, 0, 2);
    m->major = (uint8_t)tp_get_le(in, length, 2, 1);
    m->minor = (uint8_t)tp_get_le(in, length, 3, 1);
    m->schema = (uint32_t)tp_get_le(in, length, 4, 4);
    m->channels = (uint8_t)tp_get_le(in, length, 8, 1);
    m->carriers = (uint8_t)tp_get_le(in, length, 9, 1);
    m->formats = (uint16_t)tp_get_le(in, length, 10, 2);
    m->features = (uint16_t)tp_get_le(in, length, 12, 2);
    m->packet_limit = (uint16_t)tp_get_le(in, length, 14, 2);
    m->fifo_samples = (uint16_t)tp_get_le(in, length, 16, 2);
    m->tick_hz = (uint32_t)tp_get_le(in, length, 18, 4);
    m->rate_min_hz = (uint32_t)tp_get_le(in, length, 22, 4);
    m->rate_max_hz = (uint32_t)tp_get_le(in, length, 26, 4);
    m->full_scale_uv = (uint32_t)tp_get_le(in, length, 30, 4);
    m->voltage_limit_uv = (uint32_t)tp_get_le(in, length, 34, 4);
    m->slew_limit_v_per_s = (uint32_t)tp_get_le(in, length, 38, 4);
    m->fade_limit_us = (uint32_t)tp_get_le(in, length, 42, 4);
    m->firmware = (uint32_t)tp_get_le(in, length, 46, 4);
    memset(m->name, 0, 16);
    if (length > 50) {
        memcpy(m->name, in + 50, length - 50 < 16 ? length - 50 : 16);
    }
    m->marker_lines = (uint8_t)tp_get_le(in, length, 66, 1);
    return true;
}

#define TP_TIME_REPLY 0x43u
#define TP_TIME_REPLY_SIZE 24u
typedef struct {
    uint64_t host_time;
    uint64_t received;
    uint64_t sent;
} tp_time_reply;

static inline size_t tp_time_reply_encode(const tp_time_reply *m, uint8_t *out, size_t room)
{
    if (room < TP_TIME_REPLY_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->host_time, 8);
    tp_put_le(out + 8, (uint64_t)m->received, 8);
    tp_put_le(out + 16, (uint64_t)m->sent, 8);
    return 24;
}

static inline bool tp_time_reply_decode(tp_time_reply *m, const uint8_t *in, size_t length)
{
    m->host_time = (uint64_t)tp_get_le(in, length, 0, 8);
    m->received = (uint64_t)tp_get_le(in, length, 8, 8);
    m->sent = (uint64_t)tp_get_le(in, length, 16, 8);
    return true;
}

#define TP_VALUE 0x44u
#define TP_VALUE_SIZE 6u
typedef struct {
    uint16_t parameter;
    uint32_t value;
} tp_value;

static inline size_t tp_value_encode(const tp_value *m, uint8_t *out, size_t room)
{
    if (room < TP_VALUE_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->parameter, 2);
    tp_put_le(out + 2, (uint64_t)m->value, 4);
    return 6;
}

static inline bool tp_value_decode(tp_value *m, const uint8_t *in, size_t length)
{
    m->parameter = (uint16_t)tp_get_le(in, length, 0, 2);
    m->value = (uint32_t)tp_get_le(in, length, 2, 4);
    return true;
}

#define TP_PULSE 0x45u
#define TP_PULSE_SIZE 8u
typedef struct {
    uint32_t credit_position;
    uint8_t state;
    uint8_t phase;
    uint8_t underruns;
    uint8_t fill_ms;
} tp_pulse;

static inline size_t tp_pulse_encode(const tp_pulse *m, uint8_t *out, size_t room)
{
    if (room < TP_PULSE_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->credit_position, 4);
    tp_put_le(out + 4, (uint64_t)m->state, 1);
    tp_put_le(out + 5, (uint64_t)m->phase, 1);
    tp_put_le(out + 6, (uint64_t)m->underruns, 1);
    tp_put_le(out + 7, (uint64_t)m->fill_ms, 1);
    return 8;
}

static inline bool tp_pulse_decode(tp_pulse *m, const uint8_t *in, size_t length)
{
    m->credit_position = (uint32_t)tp_get_le(in, length, 0, 4);
    m->state = (uint8_t)tp_get_le(in, length, 4, 1);
    m->phase = (uint8_t)tp_get_le(in, length, 5, 1);
    m->underruns = (uint8_t)tp_get_le(in, length, 6, 1);
    m->fill_ms = (uint8_t)tp_get_le(in, length, 7, 1);
    return true;
}

#define TP_STATUS 0x46u
#define TP_STATUS_SIZE 124u
typedef struct {
    uint8_t state;
    uint8_t phase;
    uint8_t fault;
    uint8_t estop_reason;
    uint16_t session;
    uint32_t position;
    uint64_t time;
    uint8_t sync_index;
    uint64_t sync_time;
    uint32_t voltage_limit_uv;
    uint32_t slew_limit_v_per_s;
    uint32_t fade_us;
    uint32_t packets;
    uint32_t crc_errors;
    uint32_t malformed;
    uint32_t oversized;
    uint32_t fragments_dropped;
    uint32_t wrong_version;
    uint32_t unsupported;
    uint32_t unknown_type;
    uint32_t foreign_session;
    uint32_t refused;
    uint32_t ignored;
    uint32_t wrong_channel;
    uint32_t wrong_format;
    uint32_t late_samples;
    uint32_t future_samples;
    uint32_t lost_samples;
    uint32_t underruns;
    uint32_t limited_samples;
    uint32_t watchdogs;
    uint32_t dropped_replies;
    uint32_t trips;
    uint8_t inputs;
} tp_status;

static inline size_t tp_status_encode(const tp_status *m, uint8_t *out, size_t room)
{
    if (room < TP_STATUS_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->state, 1);
    tp_put_le(out + 1, (uint64_t)m->phase, 1);
    tp_put_le(out + 2, (uint64_t)m->fault, 1);
    tp_put_le(out + 3, (uint64_t)m->estop_reason, 1);
    tp_put_le(out + 4, (uint64_t)m->session, 2);
    tp_put_le(out + 6, (uint64_t)m->position, 4);
    tp_put_le(out + 10, (uint64_t)m->time, 8);
    tp_put_le(out + 18, (uint64_t)m->sync_index, 1);
    tp_put_le(out + 19, (uint64_t)m->sync_time, 8);
    tp_put_le(out + 27, (uint64_t)m->voltage_limit_uv, 4);
    tp_put_le(out + 31, (uint64_t)m->slew_limit_v_per_s, 4);
    tp_put_le(out + 35, (uint64_t)m->fade_us, 4);
    tp_put_le(out + 39, (uint64_t)m->packets, 4);
    tp_put_le(out + 43, (uint64_t)m->crc_errors, 4);
    tp_put_le(out + 47, (uint64_t)m->malformed, 4);
    tp_put_le(out + 51, (uint64_t)m->oversized, 4);
    tp_put_le(out + 55, (uint64_t)m->fragments_dropped, 4);
    tp_put_le(out + 59, (uint64_t)m->wrong_version, 4);
    tp_put_le(out + 63, (uint64_t)m->unsupported, 4);
    tp_put_le(out + 67, (uint64_t)m->unknown_type, 4);
    tp_put_le(out + 71, (uint64_t)m->foreign_session, 4);
    tp_put_le(out + 75, (uint64_t)m->refused, 4);
    tp_put_le(out + 79, (uint64_t)m->ignored, 4);
    tp_put_le(out + 83, (uint64_t)m->wrong_channel, 4);
    tp_put_le(out + 87, (uint64_t)m->wrong_format, 4);
    tp_put_le(out + 91, (uint64_t)m->late_samples, 4);
    tp_put_le(out + 95, (uint64_t)m->future_samples, 4);
    tp_put_le(out + 99, (uint64_t)m->lost_samples, 4);
    tp_put_le(out + 103, (uint64_t)m->underruns, 4);
    tp_put_le(out + 107, (uint64_t)m->limited_samples, 4);
    tp_put_le(out + 111, (uint64_t)m->watchdogs, 4);
    tp_put_le(out + 115, (uint64_t)m->dropped_replies, 4);
    tp_put_le(out + 119, (uint64_t)m->trips, 4);
    tp_put_le(out + 123, (uint64_t)m->inputs, 1);
    return 124;
}

static inline bool tp_status_decode(tp_status *m, const uint8_t *in, size_t length)
{
    m->state = (uint8_t)tp_get_le(in, length, 0, 1);
    m->phase = (uint8_t)tp_get_le(in, length, 1, 1);
    m->fault = (uint8_t)tp_get_le(in, length, 2, 1);
    m->estop_reason = (uint8_t)tp_get_le(in, length, 3, 1);
    m->session = (uint16_t)tp_get_le(in, length, 4, 2);
    m->position = (uint32_t)tp_get_le(in, length, 6, 4);
    m->time = (uint64_t)tp_get_le(in, length, 10, 8);
    m->sync_index = (uint8_t)tp_get_le(in, length, 18, 1);
    m->sync_time = (uint64_t)tp_get_le(in, length, 19, 8);
    m->voltage_limit_uv = (uint32_t)tp_get_le(in, length, 27, 4);
    m->slew_limit_v_per_s = (uint32_t)tp_get_le(in, length, 31, 4);
    m->fade_us = (uint32_t)tp_get_le(in, length, 35, 4);
    m->packets = (uint32_t)tp_get_le(in, length, 39, 4);
    m->crc_errors = (uint32_t)tp_get_le(in, length, 43, 4);
    m->malformed = (uint32_t)tp_get_le(in, length, 47, 4);
    m->oversized = (uint32_t)tp_get_le(in, length, 51, 4);
    m->fragments_dropped = (uint32_t)tp_get_le(in, length, 55, 4);
    m->wrong_version = (uint32_t)tp_get_le(in, length, 59, 4);
    m->unsupported = (uint32_t)tp_get_le(in, length, 63, 4);
    m->unknown_type = (uint32_t)tp_get_le(in, length, 67, 4);
    m->foreign_session = (uint32_t)tp_get_le(in, length, 71, 4);
    m->refused = (uint32_t)tp_get_le(in, length, 75, 4);
    m->ignored = (uint32_t)tp_get_le(in, length, 79, 4);
    m->wrong_channel = (uint32_t)tp_get_le(in, length, 83, 4);
    m->wrong_format = (uint32_t)tp_get_le(in, length, 87, 4);
    m->late_samples = (uint32_t)tp_get_le(in, length, 91, 4);
    m->future_samples = (uint32_t)tp_get_le(in, length, 95, 4);
    m->lost_samples = (uint32_t)tp_get_le(in, length, 99, 4);
    m->underruns = (uint32_t)tp_get_le(in, length, 103, 4);
    m->limited_samples = (uint32_t)tp_get_le(in, length, 107, 4);
    m->watchdogs = (uint32_t)tp_get_le(in, length, 111, 4);
    m->dropped_replies = (uint32_t)tp_get_le(in, length, 115, 4);
    m->trips = (uint32_t)tp_get_le(in, length, 119, 4);
    m->inputs = (uint8_t)tp_get_le(in, length, 123, 1);
    return true;
}

#define TP_SENSE 0x47u
#define TP_SENSE_SIZE 6u
typedef struct {
    uint32_t position;
    uint8_t first_channel;
    uint8_t channels;
    const uint8_t *readings;
    size_t readings_size;
} tp_sense;

static inline size_t tp_sense_encode(const tp_sense *m, uint8_t *out, size_t room)
{
    if (room < TP_SENSE_SIZE || room - TP_SENSE_SIZE < m->readings_size) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->position, 4);
    tp_put_le(out + 4, (uint64_t)m->first_channel, 1);
    tp_put_le(out + 5, (uint64_t)m->channels, 1);
    if (m->readings_size > 0) {
        memcpy(out + TP_SENSE_SIZE, m->readings, m->readings_size);
    }
    return TP_SENSE_SIZE + m->readings_size;
}

static inline bool tp_sense_decode(tp_sense *m, const uint8_t *in, size_t length)
{
    if (length < TP_SENSE_SIZE) {
        return false;
    }
    m->position = (uint32_t)tp_get_le(in, length, 0, 4);
    m->first_channel = (uint8_t)tp_get_le(in, length, 4, 1);
    m->channels = (uint8_t)tp_get_le(in, length, 5, 1);
    m->readings = in + 6;
    m->readings_size = length - 6;
    return true;
}

#define TP_LOG 0x48u
#define TP_LOG_SIZE 1u
typedef struct {
    uint8_t level;
    const uint8_t *text;
    size_t text_size;
} tp_log;

static inline size_t tp_log_encode(const tp_log *m, uint8_t *out, size_t room)
{
    if (room < TP_LOG_SIZE || room - TP_LOG_SIZE < m->text_size) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->level, 1);
    if (m->text_size > 0) {
        memcpy(out + TP_LOG_SIZE, m->text, m->text_size);
    }
    return TP_LOG_SIZE + m->text_size;
}

static inline bool tp_log_decode(tp_log *m, const uint8_t *in, size_t length)
{
    if (length < TP_LOG_SIZE) {
        return false;
    }
    m->level = (uint8_t)tp_get_le(in, length, 0, 1);
    m->text = in + 1;
    m->text_size = length - 1;
    return true;
}

#define TP_CORRELATION 0x49u
#define TP_CORRELATION_SIZE 11u
typedef struct {
    uint32_t position;
    uint16_t range_ua;
    uint16_t samples;
    uint8_t first_channel;
    uint8_t channels;
    uint8_t lags;
    const uint8_t *entries;
    size_t entries_size;
} tp_correlation;

static inline size_t tp_correlation_encode(const tp_correlation *m, uint8_t *out, size_t room)
{
    if (room < TP_CORRELATION_SIZE || room - TP_CORRELATION_SIZE < m->entries_size) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->position, 4);
    tp_put_le(out + 4, (uint64_t)m->range_ua, 2);
    tp_put_le(out + 6, (uint64_t)m->samples, 2);
    tp_put_le(out + 8, (uint64_t)m->first_channel, 1);
    tp_put_le(out + 9, (uint64_t)m->channels, 1);
    tp_put_le(out + 10, (uint64_t)m->lags, 1);
    if (m->entries_size > 0) {
        memcpy(out + TP_CORRELATION_SIZE, m->entries, m->entries_size);
    }
    return TP_CORRELATION_SIZE + m->entries_size;
}

static inline bool tp_correlation_decode(tp_correlation *m, const uint8_t *in, size_t length)
{
    if (length < TP_CORRELATION_SIZE) {
        return false;
    }
    m->position = (uint32_t)tp_get_le(in, length, 0, 4);
    m->range_ua = (uint16_t)tp_get_le(in, length, 4, 2);
    m->samples = (uint16_t)tp_get_le(in, length, 6, 2);
    m->first_channel = (uint8_t)tp_get_le(in, length, 8, 1);
    m->channels = (uint8_t)tp_get_le(in, length, 9, 1);
    m->lags = (uint8_t)tp_get_le(in, length, 10, 1);
    m->entries = in + 11;
    m->entries_size = length - 11;
    return true;
}

#define TP_GUARDED 0x4Au
#define TP_GUARDED_SIZE 4u
typedef struct {
    uint32_t position;
    const uint8_t *reasons;
    size_t reasons_size;
} tp_guarded;

static inline size_t tp_guarded_encode(const tp_guarded *m, uint8_t *out, size_t room)
{
    if (room < TP_GUARDED_SIZE || room - TP_GUARDED_SIZE < m->reasons_size) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->position, 4);
    if (m->reasons_size > 0) {
        memcpy(out + TP_GUARDED_SIZE, m->reasons, m->reasons_size);
    }
    return TP_GUARDED_SIZE + m->reasons_size;
}

static inline bool tp_guarded_decode(tp_guarded *m, const uint8_t *in, size_t length)
{
    if (length < TP_GUARDED_SIZE) {
        return false;
    }
    m->position = (uint32_t)tp_get_le(in, length, 0, 4);
    m->reasons = in + 4;
    m->reasons_size = length - 4;
    return true;
}

#define TP_MARKED 0x4Bu
#define TP_MARKED_SIZE 5u
typedef struct {
    uint32_t position;
    uint8_t code;
} tp_marked;

static inline size_t tp_marked_encode(const tp_marked *m, uint8_t *out, size_t room)
{
    if (room < TP_MARKED_SIZE) {
        return 0;
    }
    tp_put_le(out + 0, (uint64_t)m->position, 4);
    tp_put_le(out + 4, (uint64_t)m->code, 1);
    return 5;
}

static inline bool tp_marked_decode(tp_marked *m, const uint8_t *in, size_t length)
{
    m->position = (uint32_t)tp_get_le(in, length, 0, 4);
    m->code = (uint8_t)tp_get_le(in, length, 4, 1);
    return true;
}

#endif
