/* Effects of the messages that change states, sessions and the stream, each after check 9 of section
 * 5. */
#include "tactile_internal.h"

static const uint8_t on_hello_other[] = TP_TABLE_HELLO_OTHER;

/* Session and time */

/* Section 6.1: another session begins with the hardware's limits, no carriers, no sync and no windows. */
static void take_session(ta_amplifier *amp, uint16_t session)
{
    const ta_config *c = &amp->config;
    amp->session = session;
    ta_limit(amp, c->voltage_limit_uv, c->slew_limit_v_per_s, c->fade_limit_us);
    amp->player.carriers = 0;
    amp->sync_index = 0;
    amp->sync_tick = 0;
    amp->correlation_ms = 0;
    amp->alive = false;
    amp->pulse_now = true;
}

/* Returns whether HELLO is BUSY (6.1): a host that is alive is not displaced, nor while an output is
 * not at 0 V. */
static bool busy(const ta_amplifier *amp, uint64_t now)
{
    bool lives = amp->alive &&
                 !ta_elapsed(now, amp->heartbeat, TP_WATCHDOG_MS, amp->config.tick_hz);
    return lives || !amp->player.silent;
}

static ta_verdict check_hello(ta_amplifier *amp, const tp_hello *m, bool other, uint64_t now)
{
    if (other) {
        ta_verdict v = ta_by_table(amp, on_hello_other);
        if (v != TA_DONE) {
            return v;
        }
        if (busy(amp, now)) {
            return ta_refuse(amp, TP_NAK_BUSY, 0);
        }
    }
    if (m->major != TP_MAJOR) {
        return ta_refuse_as(amp, &amp->counters.wrong_version, TP_NAK_VERSION, TP_MAJOR);
    }
    return TA_DONE;
}

ta_verdict ta_act_hello(ta_amplifier *amp, const ta_request *r)
{
    tp_hello m;
    (void)tp_hello_decode(&m, r->packet.payload, r->packet.size);
    bool other = m.session != 0 && m.session != amp->session;
    ta_lock(amp);
    ta_verdict v = check_hello(amp, &m, other, r->now);
    if (v == TA_DONE && other) {
        take_session(amp, m.session);
    }
    ta_unlock(amp);
    if (v == TA_DONE) {
        ta_send_caps(amp);
    }
    return v;
}

ta_verdict ta_act_time(ta_amplifier *amp, const ta_request *r)
{
    uint8_t packet[TA_OVERHEAD + TP_TIME_REPLY_SIZE];
    tp_time m;
    tp_time_reply reply;
    if (r->to_all) {
        return TA_DONE;
    }
    (void)tp_time_decode(&m, r->packet.payload, r->packet.size);
    reply.host_time = m.host_time;
    reply.received = r->now;
    reply.sent = amp->hal.clock != NULL ? amp->hal.clock(amp->hal.context) : r->now;
    ta_send(amp, TP_TIME_REPLY, packet,
            tp_time_reply_encode(&reply, packet + TA_HEADER, TP_TIME_REPLY_SIZE));
    return TA_DONE;
}

ta_verdict ta_act_sync(ta_amplifier *amp, const ta_request *r)
{
    tp_sync m;
    (void)tp_sync_decode(&m, r->packet.payload, r->packet.size);
    amp->sync_index = m.index;
    amp->sync_tick = r->now;
    return TA_DONE;
}

/* HEARTBEAT or ARM of the owner. */
static void feed_watchdog(ta_amplifier *amp, uint64_t now)
{
    amp->watched = true;
    amp->alive = true;
    amp->heartbeat = now;
}

ta_verdict ta_act_heartbeat(ta_amplifier *amp, const ta_request *r)
{
    feed_watchdog(amp, r->now);
    return TA_DONE;
}

/* States */

ta_verdict ta_act_arm(ta_amplifier *amp, const ta_request *r)
{
    const ta_config *c = &amp->config;
    tp_arm m;
    (void)tp_arm_decode(&m, r->packet.payload, r->packet.size);
    if (m.mode > TP_MODE_SPECTRUM) {
        return ta_refuse(amp, TP_NAK_RANGE, 1);
    }
    if (m.sample_rate_hz < c->rate_min_hz || m.sample_rate_hz > c->rate_max_hz ||
        !ta_reach_zero(c, amp->voltage_uv, amp->slew_v_per_s, m.sample_rate_hz)) {
        return ta_refuse(amp, TP_NAK_RANGE, 2);
    }
    amp->player.mode = m.mode;
    ta_set_rate(amp, m.sample_rate_hz, r->now);
    feed_watchdog(amp, r->now);
    ta_apply(amp, ta_on_arm[amp->state]);
    return TA_DONE;
}

static ta_verdict check_start(ta_amplifier *amp, const tp_start *m, uint64_t now)
{
    ta_verdict v = ta_by_table(amp, ta_on_start);
    if (v != TA_DONE) {
        return v;
    }
    if (amp->player.mode == TP_MODE_SPECTRUM && amp->player.carriers == 0) {
        return ta_refuse(amp, TP_NAK_CARRIERS, 0);
    }
    if (m->time != 0 && (m->time < now || m->time - now > (uint64_t)amp->config.tick_hz *
                                                              TP_START_AHEAD_MS / 1000u)) {
        return ta_refuse(amp, TP_NAK_TIME, 0);
    }
    return TA_DONE;
}

static ta_verdict start(ta_amplifier *amp, const tp_start *m, uint64_t now)
{
    if (amp->state == TP_STATE_RUNNING && m->position == amp->start_position) {
        return TA_DONE;
    }
    ta_verdict v = check_start(amp, m, now);
    if (v == TA_DONE) {
        uint64_t tick = m->time != 0 ? m->time : now + (uint64_t)m->delay_ms * amp->config.tick_hz / 1000u;
        amp->start_pending = true;
        amp->start_position = m->position;
        amp->start_tick = tick > amp->last_tick ? tick : amp->last_tick;
        ta_player_start(&amp->player, m->position);
        ta_marks_forget(&amp->marks);
        ta_apply(amp, ta_on_start[amp->state]);
    }
    return v;
}

/* What a START clears is too long for a lock. It is cleared before, in ARMED, the only state from which a START
 * leads on: no instant uses it there. A RAMPDOWN may end between the two, so that ARMED comes after. */
ta_verdict ta_act_start(ta_amplifier *amp, const ta_request *r)
{
    bool cleared;
    tp_start m;
    (void)tp_start_decode(&m, r->packet.payload, r->packet.size);
    for (;;) {
        cleared = amp->state == TP_STATE_ARMED;
        if (cleared) {
            ta_serve(amp); /* a window that is complete is sent before it is cleared */
            ta_player_clear(&amp->player);
            ta_correlation_start(amp);
        }
        ta_lock(amp);
        if (cleared || amp->state != TP_STATE_ARMED) {
            break;
        }
        ta_unlock(amp);
    }
    ta_verdict v = start(amp, &m, r->now);
    ta_unlock(amp);
    return v;
}

ta_verdict ta_act_stop(ta_amplifier *amp, const ta_request *r)
{
    tp_stop m;
    (void)tp_stop_decode(&m, r->packet.payload, r->packet.size);
    ta_apply(amp, ta_on_stop[amp->state]);
    if (m.quick != 0 && amp->state == TP_STATE_RAMPDOWN) {
        amp->player.quick = true;
    }
    return TA_DONE;
}

ta_verdict ta_act_disarm(ta_amplifier *amp, const ta_request *r)
{
    (void)r;
    ta_apply(amp, ta_on_disarm[amp->state]);
    return TA_DONE;
}

ta_verdict ta_act_estop(ta_amplifier *amp, const ta_request *r)
{
    tp_estop m;
    (void)tp_estop_decode(&m, r->packet.payload, r->packet.size);
    amp->estop_reason = m.reason != TP_ESTOP_REASON_INPUT ? m.reason : 0;
    amp->counters.trips++;
    ta_apply(amp, ta_on_estop[amp->state]);
    return TA_DONE;
}

/* FAULT or ESTOP: the states in which the output may be on its way to 0 V, and which latch. */
static bool latched(const ta_amplifier *amp)
{
    return amp->state == TP_STATE_FAULT || amp->state == TP_STATE_ESTOP;
}

ta_verdict ta_act_clear_fault(ta_amplifier *amp, const ta_request *r)
{
    tp_clear_fault m;
    (void)tp_clear_fault_decode(&m, r->packet.payload, r->packet.size);
    if (latched(amp)) {
        uint8_t fault = amp->hal.fault != NULL ? amp->hal.fault(amp->hal.context)
                                               : amp->hardware_fault;
        if (m.trips != amp->counters.trips) {
            return ta_refuse(amp, TP_NAK_STATE, amp->counters.trips);
        }
        if (!amp->player.silent) {
            return ta_refuse(amp, TP_NAK_STATE, 0);
        }
        if (ta_input_open(amp, r->now)) {
            return ta_refuse(amp, TP_NAK_INPUT_OPEN, 0);
        }
        if (fault != TP_FAULT_NONE) {
            return ta_refuse(amp, TP_NAK_FAULT, fault);
        }
        amp->fault = TP_FAULT_NONE;
    }
    ta_apply(amp, ta_on_clear_fault[amp->state]);
    return TA_DONE;
}

/* Streams */

/* Whether a stream message fits mode and channels; the rest is the format's. */
static ta_verdict check_stream(ta_amplifier *amp, bool format_known, uint8_t format, uint8_t first,
                            uint8_t channels)
{
    uint32_t end = (uint32_t)first + channels;
    if (!format_known) {
        return ta_refuse_as(amp, &amp->counters.wrong_format, TP_NAK_FORMAT, format);
    }
    if (channels == 0 || end > amp->config.channels) {
        return ta_refuse_as(amp, &amp->counters.wrong_channel, TP_NAK_CHANNEL, end);
    }
    return TA_DONE;
}

/* Whether a known format is in CAPS. */
static bool has_format(const ta_amplifier *amp, uint8_t format)
{
    return ((uint32_t)amp->config.formats >> format & 1u) != 0;
}

static ta_verdict not_running(ta_amplifier *amp)
{
    return ta_refuse_as(amp, &amp->counters.ignored, TP_NAK_STATE, 0);
}

/* Row by row, each decoded outside of the lock. */
static void keep_samples(ta_amplifier *amp, const tp_pcm *m, const ta_samples *samples)
{
    ta_set channels = {{0}};
    for (size_t c = 0; c < samples->channels; c++) {
        ta_set_add(&channels, m->first_channel + c);
    }
    ta_lock(amp);
    for (uint8_t i = 0; i < samples->samples; i++) {
        int16_t *codes = ta_player_row(&amp->player, m->position + i);
        if (codes != NULL) {
            ta_unlock(amp);
            ta_samples_row(samples, i, codes + m->first_channel);
            ta_lock(amp);
            ta_player_keep_row(&amp->player, m->position + i, &channels);
        }
    }
    ta_unlock(amp);
}

ta_verdict ta_act_pcm(ta_amplifier *amp, const ta_request *r)
{
    tp_pcm m = {0};
    ta_samples samples;
    if (amp->state != TP_STATE_RUNNING) {
        return not_running(amp);
    }
    (void)tp_pcm_decode(&m, r->packet.payload, r->packet.size);
    bool known = amp->player.mode == TP_MODE_PCM && m.format <= TP_SAMPLE_FORMAT_BFP8 &&
                 has_format(amp, m.format);
    ta_verdict v = check_stream(amp, known, m.format, m.first_channel, m.channels);
    if (v != TA_DONE) {
        return v;
    }
    if (m.samples == 0 || m.data_size != ta_samples_size(m.format, m.channels, m.samples)) {
        return ta_malformed(amp, r);
    }
    samples.format = m.format;
    samples.channels = m.channels;
    samples.samples = m.samples;
    samples.data = m.data;
    keep_samples(amp, &m, &samples);
    return TA_DONE;
}

#if TA_CORRELATES

ta_verdict ta_act_guard(ta_amplifier *amp, const ta_request *r)
{
    tp_guard m = {0};
    if (amp->state != TP_STATE_RUNNING) {
        return not_running(amp);
    }
    (void)tp_guard_decode(&m, r->packet.payload, r->packet.size);
    ta_verdict v = check_stream(amp, true, 0, m.first_channel, m.channels);
    if (v != TA_DONE) {
        return v;
    }
    if (m.entries_size != TA_GUARD_ENTRY * m.channels) {
        return ta_malformed(amp, r);
    }
    for (size_t i = 0; i < m.channels; i++) {
        if (!ta_guard_valid(m.entries + TA_GUARD_ENTRY * i)) {
            return ta_refuse(amp, TP_NAK_RANGE, 1);
        }
    }
    for (size_t i = 0; i < m.channels; i++) {
        ta_guard_entry entry;
        ta_guard_decode(&entry, m.entries + TA_GUARD_ENTRY * i);
        ta_lock(amp);
        ta_guard_take(&amp->guard, m.first_channel + i, &entry);
        ta_unlock(amp);
    }
    return TA_DONE;
}

#else

ta_verdict ta_act_guard(ta_amplifier *amp, const ta_request *r)
{
    (void)amp;
    (void)r;
    return TA_DONE;
}

#endif

ta_verdict ta_act_carriers(ta_amplifier *amp, const ta_request *r)
{
    tp_carriers m = {0};
    (void)tp_carriers_decode(&m, r->packet.payload, r->packet.size);
    if (m.count == 0 || m.count > amp->config.carriers) {
        return ta_refuse(amp, TP_NAK_RANGE, 1);
    }
    if (m.increments_size != 4u * m.count) {
        return ta_malformed(amp, r);
    }
    amp->player.carriers = m.count;
    for (size_t i = 0; i < m.count; i++) {
        amp->player.increments[i] =
            (uint32_t)tp_get_le(m.increments, m.increments_size, 4u * i, 4);
    }
    return TA_DONE;
}

/* Channel by channel, each decoded outside of the lock. */
static void keep_frames(ta_amplifier *amp, const tp_spectrum *m)
{
    ta_lock(amp);
    for (size_t i = 0; i < m->channels; i++) {
        ta_frame *frame = ta_player_frame(&amp->player, m->first_channel + i, m->position);
        if (frame != NULL) {
            ta_unlock(amp);
            ta_frame_decode(frame, m->valid, m->envelopes + 2u * m->carriers * i, m->carriers);
            ta_lock(amp);
            ta_player_keep_frame(&amp->player, m->first_channel + i, frame);
        }
    }
    ta_unlock(amp);
}

ta_verdict ta_act_spectrum(ta_amplifier *amp, const ta_request *r)
{
    tp_spectrum m = {0};
    if (amp->state != TP_STATE_RUNNING) {
        return not_running(amp);
    }
    (void)tp_spectrum_decode(&m, r->packet.payload, r->packet.size);
    bool known = amp->player.mode == TP_MODE_SPECTRUM &&
                 m.format == TP_SAMPLE_FORMAT_SPECTRUM8 && has_format(amp, m.format) &&
                 m.carriers == amp->player.carriers;
    ta_verdict v = check_stream(amp, known, m.format, m.first_channel, m.channels);
    if (v != TA_DONE) {
        return v;
    }
    if (m.envelopes_size != 2u * m.channels * m.carriers) {
        return ta_malformed(amp, r);
    }
    keep_frames(amp, &m);
    return TA_DONE;
}

#if TA_MARKER_LINES > 0

ta_verdict ta_act_mark(ta_amplifier *amp, const ta_request *r)
{
    tp_mark m;
    if (amp->state != TP_STATE_RUNNING) {
        return not_running(amp);
    }
    (void)tp_mark_decode(&m, r->packet.payload, r->packet.size);
    if (m.code == 0 || m.code >> amp->config.marker_lines != 0) {
        return ta_refuse(amp, TP_NAK_RANGE, 2);
    }
    if (m.samples == 0) {
        return ta_refuse(amp, TP_NAK_RANGE, 3);
    }
    const ta_mark mark = {.position = m.position, .samples = m.samples, .code = m.code};
    ta_marks_keep(&amp->marks, &amp->player, &mark);
    return TA_DONE;
}

#else

ta_verdict ta_act_mark(ta_amplifier *amp, const ta_request *r)
{
    (void)amp;
    (void)r;
    return TA_DONE;
}

#endif
