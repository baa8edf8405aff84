/* The player; see the header. Each instant goes through three steps that do not know of each other:
 * the phase is settled, every channel gets its value, the last stage bounds it. */
#include "tactile_player.h"

/* The buffer: rows of channels, from `head` on. */

static int16_t *row(ta_player *p, uint32_t ahead)
{
    return p->buffer[(p->head + ahead) % p->fifo];
}

static void clear_row(ta_player *p, uint32_t ahead)
{
    int16_t *samples = row(p, ahead);
    for (size_t c = 0; c < p->channels; c++) {
        samples[c] = TA_NOTHING;
    }
}

static void clear_buffer(ta_player *p)
{
    for (uint32_t i = 0; i < p->fill; i++) {
        clear_row(p, i);
    }
    p->fill = 0;
}

void ta_player_init(ta_player *p, ta_counters *counters, uint8_t channels, uint16_t fifo)
{
    memset(p, 0, sizeof *p);
    p->counters = counters;
    p->channels = channels;
    p->fifo = fifo;
    p->fill = fifo; /* that START clears all */
    ta_player_start(p, 0);
    p->moved = true;
}

void ta_player_start(ta_player *p, uint32_t position)
{
    p->position = position;
    p->moved = false;
    p->phase = TP_PHASE_WAITING;
    p->gain = 0;
    p->quick = false;
    clear_buffer(p);
    memset(p->lines, 0, sizeof p->lines);
    for (size_t c = 0; c < p->channels; c++) {
        ta_envelope_clear(&p->envelopes[c]);
        p->held[c] = TA_GAIN_FULL;
    }
}

/* What is kept `ahead` of the position may be the newest. */
static void note_newest(ta_player *p, int32_t ahead)
{
    p->fill = (uint16_t)(ahead >= p->fill ? ahead + 1 : p->fill);
}

void ta_player_pcm(ta_player *p, uint32_t position, uint8_t first, const ta_samples *samples)
{
    for (uint8_t i = 0; i < samples->samples; i++) {
        int32_t ahead = ta_distance(position + i, p->position);
        if (ahead < 0) {
            p->counters->late_samples++;
        } else if (ahead >= p->fifo) {
            p->counters->future_samples++;
        } else {
            int16_t *to = row(p, (uint32_t)ahead) + first;
            for (uint8_t c = 0; c < samples->channels; c++) {
                to[c] = ta_samples_get(samples, c, i);
                p->lines[first + c].active = true;
            }
            note_newest(p, ahead);
        }
    }
}

void ta_player_frame(ta_player *p, uint32_t position, uint16_t valid, uint8_t first,
                     uint8_t channels, const uint8_t *envelopes)
{
    size_t size = 2u * p->carriers;
    uint32_t longest = p->rate * TP_VALID_MS / 1000u;
    ta_frame frame;
    frame.position = position;
    frame.valid = valid < longest ? valid : (uint16_t)longest;
    for (size_t c = 0; c < channels; c++) {
        memcpy(frame.codes, envelopes + c * size, size);
        switch (ta_envelope_offer(&p->envelopes[first + c], &frame, p->position, p->fifo)) {
        case TA_FRAME_LATE:
            p->counters->late_samples++;
            break;
        case TA_FRAME_FUTURE:
            p->counters->future_samples++;
            break;
        default:
            note_newest(p, ta_distance(position, p->position));
            p->lines[first + c].active = true;
            break;
        }
    }
}

/* Phases, section 8.2. */

static bool has_sample(ta_player *p, size_t channel)
{
    return row(p, 0)[channel] != TA_NOTHING;
}

static bool is_ready(ta_player *p, size_t channel)
{
    if (p->mode == TP_MODE_SPECTRUM) {
        return ta_envelope_ready(&p->envelopes[channel], p->position, p->moved);
    }
    return has_sample(p, channel);
}

/* Whether some channel is active, and all that are have what they need at this position. */
static bool all_ready(ta_player *p)
{
    bool some = false;
    for (size_t c = 0; c < p->channels; c++) {
        if (p->lines[c].active && !is_ready(p, c)) {
            return false;
        }
        some = some || p->lines[c].active;
    }
    return some;
}

/* Begins a bridge to the channel's next sample within 20 ms; false where there is none. */
static bool begin_bridge(ta_player *p, size_t channel)
{
    ta_line *line = &p->lines[channel];
    uint32_t reach = p->rate / 50u;
    for (uint32_t ahead = 1; ahead <= reach && ahead < p->fill; ahead++) {
        int16_t sample = row(p, ahead)[channel];
        if (sample != TA_NOTHING) {
            line->from = line->value;
            line->to = sample;
            line->length = (uint16_t)(ahead + 1u);
            line->done = 0;
            return true;
        }
    }
    return false;
}

/* Whether a channel goes on at this position: by itself, or by a bridge that is begun if need be. */
static bool goes_on(ta_player *p, size_t channel)
{
    if (p->lines[channel].length > 0 || is_ready(p, channel)) {
        return true;
    }
    return p->mode == TP_MODE_PCM && begin_bridge(p, channel);
}

/* WAITING and STARVED: no ramp, and frames whose position comes are dropped (10.3). */
static void stop_envelopes(ta_player *p)
{
    for (size_t c = 0; c < p->channels; c++) {
        ta_envelope_stop(&p->envelopes[c], p->position);
    }
}

/* An underrun. Bridges are given up; envelopes still come to this position, and stay there (10.3). */
static void starve(ta_player *p)
{
    p->phase = TP_PHASE_STARVED;
    p->counters->underruns++;
    for (size_t c = 0; c < p->channels; c++) {
        p->lines[c].length = 0;
        ta_envelope_advance(&p->envelopes[c], p->position, p->moved, p->carriers);
    }
    stop_envelopes(p);
}

/* In PLAYING. In RAMPDOWN a channel that does not go on keeps its value, so that none matters. */
static bool all_go_on(ta_player *p)
{
    bool all = true;
    for (size_t c = 0; c < p->channels; c++) {
        if (p->lines[c].active && !goes_on(p, c)) {
            all = false;
        }
    }
    return all;
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

/* A sample of the bridge under way, or of the buffer, or the last value again. */
static void next_sample(ta_player *p, size_t channel)
{
    ta_line *line = &p->lines[channel];
    if (line->length > 0) {
        int32_t rise = (int32_t)line->to - line->from;
        line->done++;
        line->value = (int16_t)(line->from + rise * line->done / line->length);
        if (line->done + 1u == line->length) {
            line->length = 0;
        }
    } else if (has_sample(p, channel)) {
        line->value = row(p, 0)[channel];
    }
}

static void next_samples(ta_player *p)
{
    for (size_t c = 0; c < p->channels; c++) {
        next_sample(p, c);
    }
}

/* Sine and cosine of each carrier at this position (10.1). */
static void turn(const ta_player *p, ta_phasor *turns)
{
    for (size_t k = 0; k < p->carriers; k++) {
        uint32_t angle = p->increments[k] * p->position;
        turns[k].i = ta_cosine(angle);
        turns[k].q = ta_sine(angle);
    }
}

static void next_spectrum(ta_player *p)
{
    ta_phasor turns[TA_CARRIERS];
    turn(p, turns);
    for (size_t c = 0; c < p->channels; c++) {
        ta_envelope *envelope = &p->envelopes[c];
        if (!p->lines[c].active) {
            continue;
        }
        if (p->phase == TP_PHASE_PLAYING) {
            ta_envelope_advance(envelope, p->position, p->moved, p->carriers);
        } else if (p->gain == 0) {
            ta_envelope_silence(envelope);
        }
        if (p->gain > 0) {
            p->lines[c].value = ta_envelope_value(envelope, turns, p->carriers);
        }
    }
}

static bool bridging(const ta_player *p)
{
    for (size_t c = 0; c < p->channels; c++) {
        if (p->lines[c].length > 0) {
            return true;
        }
    }
    return false;
}

/* The values of this instant, in RUNNING and RAMPDOWN. */
static void play(ta_player *p, uint8_t state, bool come)
{
    if (state == TP_STATE_RUNNING) {
        settle(p, come);
        if (p->phase == TP_PHASE_STARVED || bridging(p)) {
            p->counters->lost_samples++;
        }
    } else if (p->phase == TP_PHASE_PLAYING) {
        (void)all_go_on(p);
    }
    move_gain(p, state);
    if (p->mode == TP_MODE_SPECTRUM) {
        next_spectrum(p);
    } else if (p->phase == TP_PHASE_PLAYING) {
        next_samples(p);
    }
}

/* The last stage, section 11.2: nothing reaches the output but through here. */

static void last_stage(ta_player *p, bool plays)
{
    for (size_t c = 0; c < p->channels; c++) {
        int32_t value = plays ? p->lines[c].value : 0;
        int32_t bounded = ta_clamp(value, p->limit);
        int32_t want = bounded * (int32_t)p->gain / (int32_t)p->gain_full;
        want = want * p->held[c] / TA_GAIN_FULL;
        int32_t last = p->codes[c];
        int32_t next = last + ta_clamp(want - last, p->step);
        p->codes[c] = (int16_t)next;
        if (plays && ((bounded != value && p->gain > 0) || next != want)) {
            p->counters->limited_samples++;
        }
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
    clear_row(p, 0);
    p->head = (uint16_t)((p->head + 1u) % p->fifo);
    p->fill = (uint16_t)(p->fill > 0 ? p->fill - 1 : 0);
    p->position++;
}

bool ta_player_silent(const ta_player *p)
{
    for (size_t c = 0; c < p->channels; c++) {
        if (p->codes[c] != 0) {
            return false;
        }
    }
    return true;
}
