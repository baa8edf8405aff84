/* What the fuzzers share: an amplifier whose HAL checks what section 14 promises of every instant. */
#ifndef FUZZ_H
#define FUZZ_H

#include <stdlib.h>

#include "../tactile_link.h"

/* Not assert(): it must hold with NDEBUG too. */
#define HOLDS(condition) ((condition) ? (void)0 : abort())

#define FUZZ_SESSION 0x1234u
#define FUZZ_MARKER_LINES 3u

typedef struct {
    ta_amplifier amp;
    ta_replies replies;
    bool arming; /* a valid ARM is being fed */
    bool plays;  /* the last codes are not all 0 */
    bool estop_open;
    uint8_t lines; /* marker lines that are high */
    uint64_t latest;  /* tick of the latest instant */
    uint64_t resumed; /* tick of the latest instant before which others were skipped */
    int16_t codes[TA_CHANNELS];
} fuzz_board;

static inline bool fuzz_send(void *context, const uint8_t *packet, size_t size)
{
    fuzz_board *b = context;
    ta_packet p;
    HOLDS(size <= TA_REPLY_MAX && ta_packet_decode(&p, packet, size));
    return ta_replies_push(&b->replies, packet, size);
}

/* Most ticks from an instant to the next. */
static inline uint64_t fuzz_period(const ta_amplifier *amp)
{
    return amp->config.tick_hz / amp->player.rate + 1u;
}

/* Duties 1 and 2: bounds of value and slope, and nothing without high voltage. */
static inline void fuzz_put_out(void *context, uint64_t tick, uint32_t position,
                                const int16_t *codes)
{
    fuzz_board *b = context;
    const ta_player *p = &b->amp.player;
    (void)position;
    b->resumed = tick - b->latest > fuzz_period(&b->amp) ? tick : b->resumed;
    b->latest = tick;
    bool fades = b->amp.state == TP_STATE_RUNNING || b->amp.state == TP_STATE_RAMPDOWN;
    HOLDS(!fades || p->gain <= p->gain_full); /* elsewhere it is what the last START left */
    b->plays = false;
    for (size_t c = 0; c < b->amp.config.channels; c++) {
        HOLDS(ta_clamp(codes[c], p->limit) == codes[c]);
        HOLDS(ta_clamp(codes[c] - b->codes[c], p->step) == codes[c] - b->codes[c]);
        b->codes[c] = codes[c];
        b->plays = b->plays || codes[c] != 0;
    }
    HOLDS(!b->plays || b->amp.high_voltage);
    HOLDS(b->lines == b->amp.marks.lines);
}

/* Duty 3: 170 ms and a sample after the last heartbeat, or after a stall as long as the way to 0 V takes. */
static inline uint64_t fuzz_deadline(const fuzz_board *b)
{
    const ta_amplifier *amp = &b->amp;
    uint64_t watchdog = amp->heartbeat + 150000u;
    uint64_t begin = b->resumed > watchdog ? b->resumed : watchdog;
    return begin + 20000u + fuzz_period(amp);
}

/* 18: marks begin in what plays, on lines that there are. */
static inline void fuzz_marks(void *context, uint8_t lines)
{
    fuzz_board *b = context;
    HOLDS(lines != b->lines && lines >> FUZZ_MARKER_LINES == 0);
    HOLDS(lines == 0 || (b->amp.state == TP_STATE_RUNNING && b->amp.player.phase == TP_PHASE_PLAYING));
    b->lines = lines;
}

static inline void fuzz_after(void *context, uint64_t tick, uint8_t state, bool high_voltage)
{
    const fuzz_board *b = context;
    HOLDS(!b->plays || tick < fuzz_deadline(b));
    HOLDS(!b->plays || (state != TP_STATE_IDLE && state != TP_STATE_SAFE && state != TP_STATE_ARMED));
    HOLDS(high_voltage || !b->plays);
    HOLDS(!b->estop_open || state == TP_STATE_ESTOP); /* 6.3 */
    HOLDS(!high_voltage || (state != TP_STATE_IDLE && state != TP_STATE_SAFE));
}

static inline void fuzz_high_voltage(void *context, bool on)
{
    const fuzz_board *b = context;
    HOLDS(on ? b->arming : !b->plays);
}

static inline bool fuzz_estop_open(void *context)
{
    const fuzz_board *b = context;
    return b->estop_open;
}

static inline void fuzz_sense(void *context, uint8_t channel, int16_t *voltage, int16_t *current)
{
    const fuzz_board *b = context;
    *voltage = b->codes[channel];
    *current = 0;
}

/* Ends of the range and -32768 among them. */
static inline void fuzz_currents(void *context, int16_t *codes)
{
    const fuzz_board *b = context;
    for (size_t c = 0; c < b->amp.config.channels; c++) {
        codes[c] = (int16_t)(b->codes[c] * (c % 2u == 0 ? 1 : -1) - (b->codes[c] == INT16_MAX ? 0 : 1));
    }
}

static inline bool fuzz_sense_range(void *context, uint16_t range_ua)
{
    (void)context;
    return range_ua % 2u == 0;
}

static inline void fuzz_power_up(fuzz_board *b, uint16_t packet_limit)
{
    ta_config config = {0};
    ta_hal hal = {0};
    memset(b, 0, sizeof *b);
    config.node = 1;
    config.channels = 4;
    config.carriers = 3;
    config.formats = 0x0F;
    config.packet_limit = packet_limit;
    config.fifo_samples = 1024;
    config.tick_hz = 1000000;
    config.rate_min_hz = 2500;
    config.rate_max_hz = 16000;
    config.full_scale_uv = 100000000;
    config.voltage_limit_uv = 90000000;
    config.slew_limit_v_per_s = 700000;
    config.fade_limit_us = 20000;
    hal.context = b;
    hal.send = fuzz_send;
    hal.put_out = fuzz_put_out;
    hal.marks = fuzz_marks;
    config.marker_lines = FUZZ_MARKER_LINES;
    hal.after = fuzz_after;
    hal.high_voltage = fuzz_high_voltage;
    hal.sense = fuzz_sense;
    hal.currents = fuzz_currents;
    hal.sense_range = fuzz_sense_range;
    config.sense_range_ua = 2500;
    hal.estop_open = fuzz_estop_open;
    HOLDS(ta_init(&b->amp, &config, &hal));
}

#endif
