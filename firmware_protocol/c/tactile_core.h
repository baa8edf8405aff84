/* Common parts of all files of the amplifier: sizes, counters and arithmetic.
 *
 * A board changes a size with -DTA_CHANNELS=24 and the like. Nothing is allocated at run time: the
 * sizes are those of arrays in structs, which the firmware may place anywhere.
 */
#ifndef TACTILE_CORE_H
#define TACTILE_CORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tactile_messages.h"

#ifndef TA_CHANNELS
#define TA_CHANNELS 64 /* largest number of drive lines */
#endif
#ifndef TA_FIFO
#define TA_FIFO 1024 /* samples kept per channel, at least 64 ms at the highest rate */
#endif
#ifndef TA_CARRIERS
#define TA_CARRIERS 16 /* largest number of carriers of spectrum frames */
#endif
#ifndef TA_PACKET_MAX
#define TA_PACKET_MAX 4096 /* bytes of the longest packet that is accepted */
#endif
#ifndef TA_QUEUE
#define TA_QUEUE 4 /* spectrum frames in the queue of a channel; 4 by section 10.3 */
#endif
#ifndef TA_TRANSFERS
#define TA_TRANSFERS 4 /* transfers that are reassembled at a time; 4 by section 3.2 */
#endif
#ifndef TA_CORRELATES
#define TA_CORRELATES 1 /* 0 leaves CORRELATION out, and its memory */
#endif
#ifndef TA_MARKER_LINES
#define TA_MARKER_LINES 8 /* largest number of marker lines; 0 leaves MARK out */
#endif
#ifndef TA_CURRENT_DELAY
#define TA_CURRENT_DELAY 0 /* largest number of instants by which currents may be late (16.1) */
#endif
#ifndef TA_REPLIES
#define TA_REPLIES 1024 /* bytes of packets that wait for an I2C host to read them */
#endif

/* A packet of the amplifier is at most a SENSE of all channels, a LOG of 200 bytes or a CORRELATION. */
#define TA_HEADER 4u
#define TA_OVERHEAD 8u
#define TA_LOG_MAX 200u
#define TA_PACKET_LEAST 136 /* least packet_limit: STATUS has 132 bytes */
#define TA_REPLY_BODY (4u * TA_CHANNELS > TA_LOG_MAX ? 4u * TA_CHANNELS : TA_LOG_MAX)
#define TA_SENSE_MAX (TP_SENSE_SIZE + TA_REPLY_BODY)
#define TA_ENTRY (4u + 2u * TP_LAGS) /* bytes of a channel in CORRELATION */
#define TA_CORRELATED (TA_CHANNELS < TP_CORRELATED_MOST ? TA_CHANNELS : TP_CORRELATED_MOST)
#define TA_CORRELATION_MAX (TA_CORRELATES * (TP_CORRELATION_SIZE + TA_CORRELATED * TA_ENTRY))
#define TA_REPLY_MAX (TA_OVERHEAD + (TA_SENSE_MAX > TA_CORRELATION_MAX ? TA_SENSE_MAX : TA_CORRELATION_MAX))

#define TA_GAIN_FULL 32768 /* gain of a channel whose guard has not tripped (17.4) */

/* C99 has no _Static_assert: an array of negative size does not compile. */
#define TA_ASSERT(name, condition) typedef char ta_assert_##name[(condition) ? 1 : -1]

TA_ASSERT(channels, TA_CHANNELS >= 1 && TA_CHANNELS <= 255);
TA_ASSERT(fifo, TA_FIFO >= 2 && TA_FIFO <= 65535);
TA_ASSERT(carriers, TA_CARRIERS >= 1 && TA_CARRIERS <= (int)TP_CARRIERS_MAX);
TA_ASSERT(packet, TA_PACKET_MAX >= TA_PACKET_LEAST && TA_PACKET_MAX <= (int)TP_PACKET_MAX);
TA_ASSERT(queue, TA_QUEUE >= 1 && TA_QUEUE <= 255);
TA_ASSERT(transfers, TA_TRANSFERS >= 1);
TA_ASSERT(marker_lines, TA_MARKER_LINES >= 0 && TA_MARKER_LINES <= (int)TP_MARKER_LINES_MOST);
TA_ASSERT(current_delay, TA_CURRENT_DELAY >= 0 && TA_CURRENT_DELAY <= 200);
TA_ASSERT(replies, TA_REPLIES >= 4 * (2 + TP_STATUS_SIZE + TA_OVERHEAD) && TA_REPLIES <= 65535);

/* Counters of section 12, in the order of STATUS. */
typedef struct {
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
} ta_counters;

/* A set of channels, a bit for each. */
#define TA_WORDS ((TA_CHANNELS + 31u) / 32u)

typedef struct {
    uint32_t words[TA_WORDS];
} ta_set;

static inline bool ta_set_has(const ta_set *set, size_t channel)
{
    return (set->words[channel / 32u] >> channel % 32u & 1u) != 0;
}

static inline void ta_set_add(ta_set *set, size_t channel)
{
    set->words[channel / 32u] |= (uint32_t)1 << channel % 32u;
}

static inline void ta_set_remove(ta_set *set, size_t channel)
{
    set->words[channel / 32u] &= ~((uint32_t)1 << channel % 32u);
}

static inline void ta_set_join(ta_set *set, const ta_set *more)
{
    for (size_t w = 0; w < TA_WORDS; w++) {
        set->words[w] |= more->words[w];
    }
}

static inline void ta_set_subtract(ta_set *set, const ta_set *less)
{
    /*@ loop invariant 0 <= w <= TA_WORDS;
        loop assigns w, set->words[0 .. TA_WORDS - 1];
        loop variant TA_WORDS - w; */
    for (size_t w = 0; w < TA_WORDS; w++) {
        set->words[w] &= ~less->words[w];
    }
}

static inline ta_set ta_set_common(const ta_set *a, const ta_set *b)
{
    ta_set both;
    for (size_t w = 0; w < TA_WORDS; w++) {
        both.words[w] = a->words[w] & b->words[w];
    }
    return both;
}

static inline bool ta_set_empty(const ta_set *set)
{
    uint32_t any = 0;
    /*@ loop invariant 0 <= w <= TA_WORDS;
        loop assigns w, any;
        loop variant TA_WORDS - w; */
    for (size_t w = 0; w < TA_WORDS; w++) {
        any |= set->words[w];
    }
    return any == 0;
}

/* Returns the distance a - b of two positions, which wrap (section 1). */
static inline int32_t ta_distance(uint32_t a, uint32_t b)
{
    uint32_t d = a - b;
    return d < 0x80000000u ? (int32_t)d : -1 - (int32_t)~d;
}

static inline int32_t ta_clamp(int32_t value, int32_t limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

/* Shifts arithmetically; C leaves it to the compiler how >> shifts a negative value. */
static inline int64_t ta_shift_right(int64_t value, unsigned bits)
{
    return value >= 0 ? value >> bits : ~(~value >> bits);
}

/* Returns value / 2^shift, rounded to the nearest integer, halves up. */
static inline int64_t ta_rounded(int64_t value, unsigned shift)
{
    return ta_shift_right(value + (shift > 0 ? (int64_t)1 << (shift - 1u) : 0), shift);
}

/* Returns whether `ms` or more have passed, at `tick_hz`, from `since` to `now`. A request may be of a tick before
 * that of an instant that interrupted it. */
static inline bool ta_elapsed(uint64_t now, uint64_t since, uint32_t ms, uint32_t tick_hz)
{
    return now >= since && (now - since) * 1000u >= (uint64_t)ms * tick_hz;
}

#endif
