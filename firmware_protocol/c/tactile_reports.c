/* Reports; see the header. */
#include "tactile_internal.h"

/* Noting, where instants are carried out. A report for which there is no room is one that was not sent. */

static void note(ta_amplifier *amp, const ta_report *report)
{
    ta_reports *r = &amp->reports;
    if (r->count == TA_REPORTS) {
        amp->counters.dropped_replies++;
        return;
    }
    r->waiting[(r->head + r->count) % TA_REPORTS] = *report;
    r->count++;
}

/* Neither PULSE nor LOG is sent before a session was taken (section 6). */
void ta_note_pulse(ta_amplifier *amp)
{
    const ta_player *p = &amp->player;
    bool plays = amp->state == TP_STATE_RUNNING || amp->state == TP_STATE_RAMPDOWN;
    uint32_t fill_ms = plays ? 1000u * p->fill / p->rate : 0;
    ta_report report = {.kind = TA_REPORT_PULSE};
    tp_pulse *m = &report.of.pulse;
    if (amp->session == 0) {
        return;
    }
    m->credit_position = p->position + p->fifo;
    m->state = amp->state;
    m->phase = ta_phase(amp);
    m->underruns = (uint8_t)amp->counters.underruns;
    m->fill_ms = (uint8_t)(fill_ms < 255u ? fill_ms : 255u);
    note(amp, &report);
}

void ta_announce(ta_amplifier *amp)
{
    if (amp->announce) {
        amp->announce = false;
        ta_note_pulse(amp);
    }
}

void ta_note_log(ta_amplifier *amp, uint8_t level, const char *text, uint8_t fault)
{
    ta_report report = {.kind = TA_REPORT_LOG, .level = level, .fault = fault, .text = text};
    if (amp->session != 0 && level >= amp->log_level) {
        note(amp, &report);
    }
}

void ta_note_sense(ta_amplifier *amp)
{
    ta_report report = {.kind = TA_REPORT_SENSE};
    note(amp, &report);
}

#if TA_CORRELATES

void ta_note_correlation(ta_amplifier *amp)
{
    ta_report report = {.kind = TA_REPORT_CORRELATION};
    note(amp, &report);
}

void ta_note_guarded(ta_amplifier *amp, uint32_t position)
{
    ta_report report = {.kind = TA_REPORT_GUARDED};
    report.of.guarded.position = position;
    for (size_t i = 0; i < amp->config.channels; i++) {
        uint8_t reason = amp->guard.guards[i].reason;
        if (reason != TP_GUARD_REASON_NONE) {
            ta_set_add(reason == TP_GUARD_REASON_LOST ? &report.of.guarded.lost : &report.of.guarded.residual, i);
        }
    }
    note(amp, &report);
}

#endif

#if TA_MARKER_LINES > 0

void ta_note_marked(ta_amplifier *amp, uint32_t position)
{
    ta_report report = {.kind = TA_REPORT_MARKED};
    report.of.marked.position = position;
    report.of.marked.code = amp->marks.lines;
    note(amp, &report);
}

#endif

/* Sending, from ta_serve */

void ta_send(ta_amplifier *amp, uint8_t type, uint8_t *packet, size_t payload_size)
{
    ta_packet p;
    p.type = type;
    p.flags = (uint8_t)(TP_MAJOR << 6);
    p.node = amp->node;
    p.seq = amp->seq++;
    p.size = payload_size;
    p.payload = NULL;
    if (!amp->hal.send(amp->hal.context, packet, ta_packet_seal(packet, &p))) {
        ta_lock(amp);
        amp->counters.dropped_replies++;
        ta_unlock(amp);
    }
}

static void send_pulse(ta_amplifier *amp, const ta_report *report)
{
    uint8_t packet[TA_OVERHEAD + TP_PULSE_SIZE];
    ta_send(amp, TP_PULSE, packet, tp_pulse_encode(&report->of.pulse, packet + TA_HEADER, TP_PULSE_SIZE));
}

/* Writes "fault " and a number of up to three digits. */
static void fault_text(char *text, uint8_t fault)
{
    char *end = text + 6;
    memcpy(text, "fault ", 6);
    if (fault >= 100u) {
        *end++ = (char)('0' + fault / 100u);
    }
    if (fault >= 10u) {
        *end++ = (char)('0' + fault / 10u % 10u);
    }
    *end++ = (char)('0' + fault % 10u);
    *end = '\0';
}

static void send_log(ta_amplifier *amp, const ta_report *report)
{
    uint8_t packet[TA_OVERHEAD + TP_LOG_SIZE + TA_LOG_MAX];
    char of_fault[10];
    const char *text = report->text;
    tp_log m;
    if (text == NULL) {
        fault_text(of_fault, report->fault);
        text = of_fault;
    }
    m.level = report->level;
    m.text = (const uint8_t *)text;
    m.text_size = strlen(text);
    ta_send(amp, TP_LOG, packet,
            tp_log_encode(&m, packet + TA_HEADER, TP_LOG_SIZE + TA_LOG_MAX));
}

/* Measures channels first ... first + count - 1 and sends what it found. */
static void send_sense(ta_amplifier *amp, uint8_t first, uint8_t count)
{
    uint8_t packet[TA_REPLY_MAX];
    uint8_t *readings = packet + TA_HEADER + TP_SENSE_SIZE;
    tp_sense m;
    m.position = amp->last_position;
    m.first_channel = first;
    m.channels = count;
    m.readings = NULL;
    m.readings_size = 0;
    size_t size = tp_sense_encode(&m, packet + TA_HEADER, TP_SENSE_SIZE);
    for (size_t i = 0; i < count; i++) {
        int16_t voltage = 0;
        int16_t current = 0;
        amp->hal.sense(amp->hal.context, (uint8_t)(first + i), &voltage, &current);
        tp_put_le(readings + 4u * i, (uint64_t)(uint16_t)voltage, 2);
        tp_put_le(readings + 4u * i + 2u, (uint64_t)(uint16_t)current, 2);
    }
    ta_send(amp, TP_SENSE, packet, size + 4u * count);
}

/* All channels, in as few packets as the limit allows. */
static void send_senses(ta_amplifier *amp)
{
    size_t most = (amp->config.packet_limit - TA_OVERHEAD - TP_SENSE_SIZE) / 4u;
    size_t channels = amp->config.channels;
    for (size_t first = 0; first < channels; first += most) {
        size_t count = channels - first < most ? channels - first : most;
        send_sense(amp, (uint8_t)first, (uint8_t)count);
    }
}

#if TA_CORRELATES

static void send_correlation(ta_amplifier *amp, const ta_window *window, uint8_t first, uint8_t count)
{
    uint8_t packet[TA_OVERHEAD + TA_CORRELATION_MAX];
    uint8_t *entries = packet + TA_HEADER + TP_CORRELATION_SIZE;
    tp_correlation m;
    m.position = window->position;
    m.range_ua = window->range_ua;
    m.samples = window->samples;
    m.first_channel = first;
    m.channels = count;
    m.lags = TP_LAGS;
    m.entries = NULL;
    m.entries_size = 0;
    size_t size = tp_correlation_encode(&m, packet + TA_HEADER, TP_CORRELATION_SIZE);
    for (size_t i = 0; i < count; i++) {
        ta_correlator_entry(&window->sums[first + i], entries + TA_ENTRY * i);
    }
    ta_send(amp, TP_CORRELATION, packet, size + TA_ENTRY * count);
}

/* The window that is complete: all channels, in as few packets as possible. */
static void send_correlations(ta_amplifier *amp)
{
    const ta_window *window = ta_correlator_window(&amp->correlator);
    size_t room = (amp->config.packet_limit - TA_OVERHEAD - TP_CORRELATION_SIZE) / TA_ENTRY;
    size_t most = room < TA_CORRELATED ? room : TA_CORRELATED;
    size_t channels = amp->config.channels;
    for (size_t first = 0; first < channels; first += most) {
        size_t count = channels - first < most ? channels - first : most;
        send_correlation(amp, window, (uint8_t)first, (uint8_t)count);
    }
    ta_correlator_sent(&amp->correlator);
}

/* Which channels have tripped, and the first position that is put out with another gain. */
static void send_guarded(ta_amplifier *amp, const ta_report *report)
{
    uint8_t packet[TA_OVERHEAD + TP_GUARDED_SIZE + TA_CHANNELS];
    uint8_t *reasons = packet + TA_HEADER + TP_GUARDED_SIZE;
    tp_guarded m;
    m.position = report->of.guarded.position;
    m.reasons = NULL;
    m.reasons_size = 0;
    size_t size = tp_guarded_encode(&m, packet + TA_HEADER, TP_GUARDED_SIZE);
    for (size_t i = 0; i < amp->config.channels; i++) {
        bool residual = ta_set_has(&report->of.guarded.residual, i);
        bool lost = ta_set_has(&report->of.guarded.lost, i);
        reasons[i] = (uint8_t)(residual ? TP_GUARD_REASON_RESIDUAL
                               : lost   ? TP_GUARD_REASON_LOST
                                        : TP_GUARD_REASON_NONE);
    }
    ta_send(amp, TP_GUARDED, packet, size + amp->config.channels);
}

#endif

#if TA_MARKER_LINES > 0

static void send_marked(ta_amplifier *amp, const ta_report *report)
{
    uint8_t packet[TA_OVERHEAD + TP_MARKED_SIZE];
    ta_send(amp, TP_MARKED, packet, tp_marked_encode(&report->of.marked, packet + TA_HEADER, TP_MARKED_SIZE));
}

#endif

static void send_report(ta_amplifier *amp, const ta_report *report)
{
    switch (report->kind) {
    case TA_REPORT_PULSE:
        send_pulse(amp, report);
        break;
    case TA_REPORT_LOG:
        send_log(amp, report);
        break;
    case TA_REPORT_SENSE:
        send_senses(amp);
        break;
#if TA_CORRELATES
    case TA_REPORT_CORRELATION:
        send_correlations(amp);
        break;
    case TA_REPORT_GUARDED:
        send_guarded(amp, report);
        break;
#endif
#if TA_MARKER_LINES > 0
    case TA_REPORT_MARKED:
        send_marked(amp, report);
        break;
#endif
    default: /* nothing else is noted */
        break;
    }
}

/* Takes the report that has waited longest. */
static bool take(ta_amplifier *amp, ta_report *report)
{
    ta_reports *r = &amp->reports;
    ta_lock(amp);
    bool any = r->count > 0;
    if (any) {
        *report = r->waiting[r->head];
        r->head = (uint8_t)((r->head + 1u) % TA_REPORTS);
        r->count--;
    }
    ta_unlock(amp);
    return any;
}

void ta_serve(ta_amplifier *amp)
{
    ta_report report;
    while (take(amp, &report)) {
        send_report(amp, &report);
    }
}
