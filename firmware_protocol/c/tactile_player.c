/* The player; see the header. Each instant goes through three steps that do not know of each other:
 * the phase is settled, every channel gets its value, the last stage bounds it. */
#include "tactile_player.h"

static const ta_set none;

/* The buffer of PCM: rows of channels, from `head` on. */

static size_t row(const ta_player *p, uint32_t ahead)
{
    uint32_t at = p->head + ahead;
    return at < p->fifo ? at : at - p->fifo;
}

static void clear_envelopes(ta_player *p)
{
    for (size_t c = 0; c < p->channels; c++) {
        ta_envelope_clear(&p->kept.envelopes[c]);
    }
}

void ta_player_init(ta_player *p, ta_counters *counters, uint8_t channels, uint16_t fifo)
{
    memset(p, 0, sizeof *p);
    p->counters = counters;
    p->channels = channels;
    p->fifo = fifo;
    p->silent = true;
    ta_player_clear(p);
    ta_player_start(p, 0);
    p->moved = true;
}

void ta_player_clear(ta_player *p)
{
    memset(p->present, 0, p->fifo * sizeof p->present[0]);
    if (p->mode == TP_MODE_SPECTRUM) {
        clear_envelopes(p);
    }
    memset(&p->active, 0, sizeof p->active);
    memset(&p->bridging, 0, sizeof p->bridging);
    memset(p->values, 0, sizeof p->values);
    for (size_t c = 0; c < p->channels; c++) {
        p->held[c] = TA_GAIN_FULL;
    }
}

void ta_player_start(ta_player *p, uint32_t position)
{
    p->position = position;
    p->fill = 0;
    p->moved = false;
    p->phase = TP_PHASE_WAITING;
    p->gain = 0;
    p->quick = false;
    p->held_down = false;
}

/* What is kept `ahead` of the position may be the newest. */
static void note_newest(ta_player *p, int32_t ahead)
{
    p->fill = (uint16_t)(ahead >= p->fill ? ahead + 1 : p->fill);
}

/* A row keeps its place until its position has been put out, so that what is written to it meanwhile is either
 * kept or, where its instant has come, of a row that holds nothing. */
int16_t *ta_player_row(ta_player *p, uint32_t position)
{
    int32_t ahead = ta_distance(position, p->position);
    if (ahead < 0) {
        p->counters->late_samples++;
        return NULL;
    }
    if (ahead >= p->fifo) {
        p->counters->future_samples++;
        return NULL;
    }
    return p->kept.samples[row(p, (uint32_t)ahead)];
}

void ta_player_keep_row(ta_player *p, uint32_t position, const ta_set *channels)
{
    int32_t ahead = ta_distance(position, p->position);
    if (ahead < 0) {
        p->counters->late_samples++;
        return;
    }
    ta_set_join(&p->present[row(p, (uint32_t)ahead)], channels);
    ta_set_join(&p->active, channels);
    note_newest(p, ahead);
}

static void count_fate(ta_player *p, ta_frame_fate fate)
{
    p->counters->late_samples += fate == TA_FRAME_LATE ? 1u : 0u;
    p->counters->future_samples += fate == TA_FRAME_FUTURE ? 1u : 0u;
}

ta_frame *ta_player_frame(ta_player *p, size_t channel, uint32_t position)
{
    ta_frame *frame = NULL;
    count_fate(p, ta_envelope_offer(&p->kept.envelopes[channel], position, p->position, p->fifo, &frame));
    return frame;
}

void ta_player_keep_frame(ta_player *p, size_t channel, ta_frame *frame)
{
    uint32_t longest = p->rate * TP_VALID_MS / 1000u;
    frame->valid = frame->valid < longest ? frame->valid : (uint16_t)longest;
    ta_frame_fate fate = ta_envelope_keep(&p->kept.envelopes[channel], frame, p->position);
    count_fate(p, fate);
    if (fate == TA_FRAME_KEPT) {
        note_newest(p, ta_distance(frame->position, p->position));
        ta_set_add(&p->active, channel);
    }
}

/* Phases, section 8.2. */

/* Whether all active channels have an envelope at this position. */
static bool envelopes_ready(const ta_player *p)
{
    /*@ loop invariant 0 <= w <= TA_WORDS;
        loop assigns w;
        loop variant TA_WORDS - w; */
    for (size_t w = 0; w < TA_WORDS; w++) {
        const ta_envelope *e = p->kept.envelopes + 32u * w;
        //@ ghost int k = 0;
        /*@ loop invariant 0 <= k <= 32 && bits <= most(k) && e == &p->kept.envelopes[32 * w + k];
            loop assigns bits, e, k;
            loop variant 32 - k; */
        for (uint32_t bits = p->active.words[w]; bits != 0; bits >>= 1, e++) {
            //@ assert k <= 31;
            if ((bits & 1u) != 0 && !ta_envelope_ready(e, p->position, p->moved)) {
                return false;
            }
            //@ ghost k++;
        }
    }
    return true;
}

/* The active channels without a sample at this position. */
static ta_set missing(const ta_player *p)
{
    ta_set channels = p->active;
    ta_set_subtract(&channels, &p->present[p->head]);
    return channels;
}

/* Whether some channel is active, and all that are have what they need at this position. */
static bool all_ready(const ta_player *p)
{
    if (ta_set_empty(&p->active)) {
        return false;
    }
    if (p->mode == TP_MODE_SPECTRUM) {
        return envelopes_ready(p);
    }
    ta_set channels = missing(p);
    return ta_set_empty(&channels);
}

static void begin_bridge(ta_player *p, size_t channel, uint32_t ahead)
{
    ta_bridge *bridge = &p->bridges[channel];
    bridge->from = p->values[channel];
    bridge->to = p->kept.samples[row(p, ahead)][channel];
    bridge->length = (uint16_t)(ahead + 1u);
    bridge->done = 0;
    ta_set_add(&p->bridging, channel);
}

/* Begins a bridge for each of these channels that has a sample within 20 ms. Returns whether all have. */
static bool begin_bridges(ta_player *p, ta_set channels)
{
    uint32_t reach = p->rate / 50u;
    for (uint32_t ahead = 1; ahead <= reach && ahead < p->fill; ahead++) {
        ta_set ends = ta_set_common(&channels, &p->present[row(p, ahead)]);
        for (size_t c = 0; !ta_set_empty(&ends); c++) {
            if (ta_set_has(&ends, c)) {
                begin_bridge(p, c, ahead);
                ta_set_remove(&ends, c);
                ta_set_remove(&channels, c);
            }
        }
        if (ta_set_empty(&channels)) {
            return true;
        }
    }
    return false;
}

/* Whether each active channel goes on at this position: by itself, or by a bridge that is begun if need be. In
 * RAMPDOWN a channel that does not go on keeps its value, so that none matters. */
static bool all_go_on(ta_player *p)
{
    if (p->mode == TP_MODE_SPECTRUM) {
        return envelopes_ready(p);
    }
    ta_set channels = missing(p);
    ta_set_subtract(&channels, &p->bridging);
    return ta_set_empty(&channels) || begin_bridges(p, channels);
}

/* WAITING and STARVED: no ramp, and frames whose position comes are dropped (10.3). */
static void stop_envelopes(ta_player *p)
{
    if (p->mode == TP_MODE_SPECTRUM) {
        /*@ loop invariant 0 <= c <= p->channels;
            loop assigns c, p->kept.envelopes[0 .. TA_CHANNELS - 1];
            loop variant p->channels - c; */
        for (size_t c = 0; c < p->channels; c++) {
            ta_envelope_stop(&p->kept.envelopes[c], p->position);
        }
    }
}

/* Values stay from here on; bridges are given up. */
static void stop_values(ta_player *p)
{
    p->phase = TP_PHASE_STARVED;
    p->bridging = none;
}

/* An underrun. Envelopes still come to this position (next_spectrum). */
static void starve(ta_player *p)
{
    stop_values(p);
    p->starving = true;
    p->counters->underruns++;
}

/* RUNNING: the phase of this instant, and with it the gain where it begins at full: at the position of
 * START, which none has followed yet. */
static void settle(ta_player *p, bool come)
{
    switch (p->phase) {
    case TP_PHASE_WAITING:
        stop_envelopes(p);
        if (come && all_ready(p)) {
            p->phase = TP_PHASE_PLAYING;
            p->gain = p->moved ? 0 : p->gain_full;
        }
        break;
    case TP_PHASE_PLAYING:
        if (!all_go_on(p)) {
            starve(p);
        }
        break;
    default:
        stop_envelopes(p);
        if (p->gain == 0 && all_ready(p)) {
            p->phase = TP_PHASE_PLAYING;
        }
        break;
    }
}

/* The gain of this instant, section 8.3. */
static void move_gain(ta_player *p, uint8_t state)
{
    bool rises = state == TP_STATE_RUNNING && p->phase == TP_PHASE_PLAYING;
    if (rises) {
        p->gain += p->gain < p->gain_full ? 1u : 0u;
    } else if (state == TP_STATE_RAMPDOWN && p->quick) {
        p->gain = 0;
    } else {
        p->gain -= p->gain > 0 ? 1u : 0u;
    }
}

/* Values before the gain. */

static void next_of_bridge(ta_player *p, size_t channel)
{
    ta_bridge *bridge = &p->bridges[channel];
    int32_t rise = (int32_t)bridge->to - bridge->from;
    int32_t done = ++bridge->done;
    p->values[channel] = (int16_t)(bridge->from + rise * done / bridge->length);
    if (bridge->done + 1u == bridge->length) {
        ta_set_remove(&p->bridging, channel);
    }
}

/* The samples of this position; a channel without one keeps its value. */
static void take_samples(ta_player *p)
{
    const ta_set *present = &p->present[p->head];
    /*@ loop invariant 0 <= w <= TA_WORDS;
        loop assigns w, p->values[0 .. TA_CHANNELS - 1];
        loop variant TA_WORDS - w; */
    for (size_t w = 0; w < TA_WORDS; w++) {
        const int16_t *sample = p->kept.samples[p->head] + 32u * w;
        int16_t *value = p->values + 32u * w;
        //@ ghost int k = 0;
        /*@ loop invariant 0 <= k <= 32 && bits <= most(k) && value == p->values + (32 * w + k);
            loop invariant sample == &p->kept.samples[p->head][32 * w + k];
            loop assigns bits, value, sample, k, p->values[0 .. TA_CHANNELS - 1];
            loop variant 32 - k; */
        for (uint32_t bits = present->words[w]; bits != 0; bits >>= 1) {
            if ((bits & 1u) != 0) {
                *value = *sample;
            }
            value++;
            sample++;
            //@ ghost k++;
        }
    }
}

/* A channel on a bridge plays that, whatever has arrived meanwhile. */
static void next_samples(ta_player *p)
{
    take_samples(p);
    if (!ta_set_empty(&p->bridging)) {
        /*@ loop invariant 0 <= c <= p->channels;
            loop assigns c, p->values[0 .. TA_CHANNELS - 1], p->bridges[0 .. TA_CHANNELS - 1], p->bridging;
            loop variant p->channels - c; */
        for (size_t c = 0; c < p->channels; c++) {
            if (ta_set_has(&p->bridging, c)) {
                next_of_bridge(p, c);
            }
        }
    }
}

/* The value of an active channel at this position, where the carriers have these turns (10.1). Envelopes go on in
 * PLAYING, and still do so at the instant of an underrun. */
static int16_t spectrum_value(ta_player *p, ta_envelope *e, const ta_phasor *turns)
{
    if (p->phase == TP_PHASE_PLAYING || p->starving) {
        return ta_envelope_next(e, p->position, p->moved, turns, p->carriers);
    }
    return ta_envelope_value(e, turns, p->carriers);
}

static void next_spectrum(ta_player *p)
{
    ta_phasor turns[TA_CARRIERS];
    const size_t carriers = p->carriers;
    /*@ loop invariant 0 <= k <= carriers;
        loop assigns k, turns[0 .. TA_CARRIERS - 1];
        loop variant carriers - k; */
    for (size_t k = 0; k < carriers; k++) {
        turns[k] = ta_turn(p->increments[k] * p->position);
    }
    /*@ loop invariant 0 <= w <= TA_WORDS;
        loop assigns w, p->values[0 .. TA_CHANNELS - 1], p->kept.envelopes[0 .. TA_CHANNELS - 1];
        loop variant TA_WORDS - w; */
    for (size_t w = 0; w < TA_WORDS; w++) {
        size_t c = 32u * w;
        //@ ghost int k = 0;
        /*@ loop invariant 0 <= k <= 32 && bits <= most(k) && c == 32 * w + k;
            loop assigns bits, c, k, p->values[0 .. TA_CHANNELS - 1], p->kept.envelopes[0 .. TA_CHANNELS - 1];
            loop variant 32 - k; */
        for (uint32_t bits = p->active.words[w]; bits != 0; bits >>= 1, c++) {
            //@ assert k <= 31;
            if ((bits & 1u) != 0) {
                p->values[c] = spectrum_value(p, &p->kept.envelopes[c], turns);
            }
            //@ ghost k++;
        }
    }
}

/* From an underrun on envelopes stay as they are, until the gain is 0 and they are 0. */
static void end_envelopes(ta_player *p)
{
    if (p->starving) {
        stop_envelopes(p);
    }
    if (p->phase != TP_PHASE_PLAYING && p->gain == 0) {
        /*@ loop invariant 0 <= c <= p->channels;
            loop assigns c, p->kept.envelopes[0 .. TA_CHANNELS - 1];
            loop variant p->channels - c; */
        for (size_t c = 0; c < p->channels; c++) {
            ta_envelope_silence(&p->kept.envelopes[c]);
        }
    }
}

/* The values of this instant, in RUNNING and RAMPDOWN. */
static void play(ta_player *p, uint8_t state, bool come)
{
    p->starving = false;
    if (state == TP_STATE_RUNNING) {
        settle(p, come);
        if (p->phase == TP_PHASE_STARVED || !ta_set_empty(&p->bridging)) {
            p->counters->lost_samples++;
        }
    } else if (p->phase == TP_PHASE_PLAYING) {
        (void)all_go_on(p);
    }
    move_gain(p, state);
    if (p->mode == TP_MODE_SPECTRUM) {
        next_spectrum(p);
        end_envelopes(p);
    } else if (p->phase == TP_PHASE_PLAYING) {
        next_samples(p);
    }
}

/* The last stage, section 11.2: nothing reaches the output but through here. */

/* The new code of a channel, which goes toward `want` by a step at most. */
static int16_t step_to(int16_t *code, int32_t want, int32_t step)
{
    int32_t last = *code;
    *code = (int16_t)(last + ta_clamp(want - last, step));
    return *code;
}

/* At full gain. Returns the number of limited samples: a code that the limit of voltage holds down never
 * reaches its value, since no code is above that limit. */
static uint32_t bound(ta_player *p, const int16_t *values)
{
    const int32_t limit = p->limit;
    const int32_t step = p->step;
    int16_t *code = p->codes;
    int16_t *const end = code + p->channels;
    uint32_t limited = 0;
    uint32_t loud = 0;
    /*@ loop invariant 0 <= code - p->codes < p->channels && code == p->codes + (code - p->codes);
        loop invariant values == \at(values, Pre) + (code - p->codes);
        loop invariant stepped{Pre, Here}(p, code - p->codes) && unchanged{Pre, Here}(p, code - p->codes);
        loop invariant loud == 0 <==> still(p, code - p->codes);
        loop assigns code, values, limited, loud, p->codes[0 .. p->channels - 1];
        loop variant end - code; */
    do {
        int16_t value = *values++;
        //@ assert fits(code(p, code - p->codes));
        int16_t next = step_to(code++, ta_clamp(value, limit), step);
        //@ assert others_stay{LoopCurrent, Here}(p, code - p->codes - 1) && code(p, code - p->codes - 1) == next;
        loud |= (uint16_t)next;
        limited += next != value ? 1u : 0u;
    } while (code < end);
    //@ assert code - p->codes == p->channels;
    p->silent = loud == 0;
    return limited;
}

/* A part of a value, truncated towards 0. */
static int32_t portion(int32_t value, int32_t part, int32_t whole)
{
    //@ assert 0 <= value * part <= value * whole || value * whole <= value * part <= 0;
    return value * part / whole;
}

/* The same where the gain of the fade, or that of a guard, is not full. */
static uint32_t bound_and_fade(ta_player *p)
{
    uint32_t limited = 0;
    uint32_t loud = 0;
    /*@ loop invariant 0 <= c <= p->channels;
        loop invariant stepped{Pre, Here}(p, c) && unchanged{Pre, Here}(p, c);
        loop invariant loud == 0 <==> still(p, c);
        loop assigns c, limited, loud, p->codes[0 .. p->channels - 1];
        loop variant p->channels - c; */
    for (size_t c = 0; c < p->channels; c++) {
        //@ assert fits(code(p, c)) && 0 <= gain(p, c) <= TA_GAIN_FULL;
        int32_t bounded = ta_clamp(p->values[c], p->limit);
        int32_t faded = portion(bounded, (int32_t)p->gain, (int32_t)p->gain_full);
        int32_t want = portion(faded, p->held[c], TA_GAIN_FULL);
        int16_t next = step_to(&p->codes[c], want, p->step);
        //@ assert others_stay{LoopCurrent, Here}(p, c) && code(p, c) == next;
        loud |= (uint16_t)next;
        limited += (bounded != p->values[c] && p->gain > 0) || next != want ? 1u : 0u;
    }
    p->silent = loud == 0;
    return limited;
}

static void last_stage(ta_player *p, bool plays)
{
    static const int16_t still[TA_CHANNELS];
    if (!plays) {
        (void)bound(p, still);
    } else if (p->gain == p->gain_full && !p->held_down) {
        p->counters->limited_samples += bound(p, p->values);
    } else {
        p->counters->limited_samples += bound_and_fade(p);
    }
}

void ta_player_instant(ta_player *p, uint8_t state, bool come)
{
    bool plays = state == TP_STATE_RUNNING || state == TP_STATE_RAMPDOWN;
    if (plays) {
        play(p, state, come);
    }
    last_stage(p, plays);
}

void ta_player_move(ta_player *p, bool hold)
{
    p->moved = !hold;
    if (hold) {
        return;
    }
    p->present[p->head] = none;
    p->head = (uint16_t)row(p, 1);
    p->fill = (uint16_t)(p->fill > 0 ? p->fill - 1 : 0);
    p->position++;
}

void ta_player_skip(ta_player *p, uint8_t state, bool hold)
{
    const uint32_t runs = state == TP_STATE_RUNNING ? 1u : 0u;
    if (p->phase == TP_PHASE_PLAYING) {
        stop_values(p);
        p->counters->underruns += runs;
    }
    if (p->phase == TP_PHASE_STARVED) {
        p->counters->lost_samples += runs;
    }
    ta_player_move(p, hold);
}
