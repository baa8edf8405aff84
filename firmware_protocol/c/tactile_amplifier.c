/* Actions of the amplifier without a request: states, sample clock, watchdog, messages sent unasked. */
#include "tactile_internal.h"

#define POWER_UP_RATE 8000u
#define POWER_UP_PULSE_MS 10u

static const uint8_t on_watchdog[] = TP_TABLE_WATCHDOG;
static const uint8_t on_fault[] = TP_TABLE_FAULT;
static const uint8_t on_estop_input[] = TP_TABLE_ESTOP_INPUT;

/* Power-up */

static uint32_t power_up_rate(const ta_config *c)
{
    if (c->rate_min_hz > POWER_UP_RATE) {
        return c->rate_min_hz;
    }
    return c->rate_max_hz < POWER_UP_RATE ? c->rate_max_hz : POWER_UP_RATE;
}

static void read_input(ta_amplifier *amp, uint64_t now);

bool ta_init(ta_amplifier *amp, const ta_config *config, const ta_hal *hal)
{
    if (ta_config_fault(config, hal, NULL) != NULL) {
        return false;
    }
    memset(amp, 0, sizeof *amp);
    amp->config = *config;
    amp->hal = *hal;
    amp->node = config->node;
    amp->next_node = config->node;
    amp->pulse_ms = POWER_UP_PULSE_MS;
    amp->log_level = TP_LOG_LEVEL_WARNING;
    amp->sense_range_ua = config->sense_range_ua;
    ta_correlation_start(amp);
    ta_player_init(&amp->player, &amp->counters, config->channels, config->fifo_samples);
    ta_set_rate(amp, power_up_rate(config), 0);
    ta_limit(amp, config->voltage_limit_uv, config->slew_limit_v_per_s, config->fade_limit_us);
    read_input(amp, 0);
    return true;
}

/* Limits, section 11.1 */

int32_t ta_limit_codes(const ta_config *c, uint32_t voltage_uv)
{
    uint64_t limit = (uint64_t)voltage_uv * TP_FULL_SCALE_CODE / c->full_scale_uv;
    return (int32_t)(limit < TP_FULL_SCALE_CODE ? limit : TP_FULL_SCALE_CODE);
}

static int32_t step_codes(const ta_config *c, uint32_t slew_v_per_s, uint32_t rate)
{
    uint64_t codes = (uint64_t)slew_v_per_s * TP_FULL_SCALE_CODE * 1000000u;
    uint64_t step = codes / ((uint64_t)c->full_scale_uv * rate);
    return step < 2u * TP_FULL_SCALE_CODE ? (int32_t)step : 2 * (int32_t)TP_FULL_SCALE_CODE;
}

bool ta_reach_zero(const ta_config *c, uint32_t voltage_uv, uint32_t slew_v_per_s, uint32_t rate)
{
    int64_t reach = (int64_t)step_codes(c, slew_v_per_s, rate) * (int64_t)(rate / 50u);
    return ta_limit_codes(c, voltage_uv) <= reach;
}

/* Derives the player's numbers from limits and rate. */
static void derive(ta_amplifier *amp)
{
    ta_player *p = &amp->player;
    uint64_t gain = ((uint64_t)amp->fade_us * p->rate + 500000u) / 1000000u;
    p->limit = ta_limit_codes(&amp->config, amp->voltage_uv);
    p->step = step_codes(&amp->config, amp->slew_v_per_s, p->rate);
    p->gain_full = gain > 0 ? (uint32_t)gain : 1u;
}

void ta_limit(ta_amplifier *amp, uint32_t voltage_uv, uint32_t slew_v_per_s, uint32_t fade_us)
{
    amp->voltage_uv = voltage_uv;
    amp->slew_v_per_s = slew_v_per_s;
    amp->fade_us = fade_us;
    derive(amp);
}

/* Messages to the host */

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
        amp->counters.dropped_replies++;
    }
}

uint8_t ta_phase(const ta_amplifier *amp)
{
    return amp->state == TP_STATE_RUNNING ? amp->player.phase : (uint8_t)TP_PHASE_STILL;
}

/* Neither PULSE nor LOG is sent before a session was taken (section 6). */
static void send_pulse(ta_amplifier *amp)
{
    uint8_t packet[TA_OVERHEAD + TP_PULSE_SIZE];
    const ta_player *p = &amp->player;
    bool plays = amp->state == TP_STATE_RUNNING || amp->state == TP_STATE_RAMPDOWN;
    uint32_t fill_ms = plays ? 1000u * p->fill / p->rate : 0;
    tp_pulse m;
    if (amp->session == 0) {
        return;
    }
    m.credit_position = p->position + p->fifo;
    m.state = amp->state;
    m.phase = ta_phase(amp);
    m.underruns = (uint8_t)amp->counters.underruns;
    m.fill_ms = (uint8_t)(fill_ms < 255u ? fill_ms : 255u);
    ta_send(amp, TP_PULSE, packet, tp_pulse_encode(&m, packet + TA_HEADER, TP_PULSE_SIZE));
}

void ta_announce(ta_amplifier *amp)
{
    if (amp->announce) {
        amp->announce = false;
        send_pulse(amp);
    }
}

static void send_log(ta_amplifier *amp, uint8_t level, const char *text)
{
    uint8_t packet[TA_OVERHEAD + TP_LOG_SIZE + TA_LOG_MAX];
    tp_log m;
    if (amp->session == 0 || level < amp->log_level) {
        return;
    }
    m.level = level;
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

/* Correlation, section 16 */

#if TA_CORRELATES

bool ta_correlates(const ta_amplifier *amp)
{
    return amp->hal.currents != NULL;
}

void ta_correlation_start(ta_amplifier *amp)
{
    ta_correlator_start(&amp->correlator, amp->config.channels, amp->config.current_delay);
    ta_guard_start(&amp->guard, amp->config.channels, amp->player.rate);
}

void ta_correlation_stop(ta_amplifier *amp)
{
    ta_correlator_stop(&amp->correlator);
}

static void send_correlation(ta_amplifier *amp, uint8_t first, uint8_t count)
{
    uint8_t packet[TA_OVERHEAD + TA_CORRELATION_MAX];
    uint8_t *entries = packet + TA_HEADER + TP_CORRELATION_SIZE;
    tp_correlation m;
    m.position = amp->correlator.position;
    m.range_ua = amp->sense_range_ua;
    m.samples = amp->correlator.samples;
    m.first_channel = first;
    m.channels = count;
    m.lags = TP_LAGS;
    m.entries = NULL;
    m.entries_size = 0;
    size_t size = tp_correlation_encode(&m, packet + TA_HEADER, TP_CORRELATION_SIZE);
    for (size_t i = 0; i < count; i++) {
        ta_correlator_entry(&amp->correlator, first + i, entries + TA_ENTRY * i);
    }
    ta_send(amp, TP_CORRELATION, packet, size + TA_ENTRY * count);
}

/* The window that is complete: all channels, in as few packets as possible. */
static void send_correlations(ta_amplifier *amp)
{
    size_t room = (amp->config.packet_limit - TA_OVERHEAD - TP_CORRELATION_SIZE) / TA_ENTRY;
    size_t most = room < TA_CORRELATED ? room : TA_CORRELATED;
    size_t channels = amp->config.channels;
    for (size_t first = 0; first < channels; first += most) {
        size_t count = channels - first < most ? channels - first : most;
        send_correlation(amp, (uint8_t)first, (uint8_t)count);
    }
}

static uint16_t window_samples(const ta_amplifier *amp)
{
    uint64_t samples = (uint64_t)amp->correlation_ms * amp->player.rate / 1000u;
    return (uint16_t)(samples < UINT16_MAX ? samples : UINT16_MAX);
}

/* Adds the currents that are known now to the window under way, or to one that begins. */
static void add_to_window(ta_amplifier *amp, uint32_t position, const int16_t *currents)
{
    ta_correlator *c = &amp->correlator;
    if (c->left == 0 && amp->correlation_ms == 0) {
        return;
    }
    ta_correlator_open(c, position, window_samples(amp));
    for (size_t i = 0; i < amp->config.channels; i++) {
        if (amp->player.held[i] < TA_GAIN_FULL) {
            ta_correlator_held(c, i);
        }
    }
    if (ta_correlator_add(c, currents)) {
        send_correlations(amp);
    }
}

/* Tells which channels have tripped, and the first position that is put out with another gain. */
static void send_guarded(ta_amplifier *amp, uint32_t position)
{
    uint8_t packet[TA_OVERHEAD + TP_GUARDED_SIZE + TA_CHANNELS];
    uint8_t *reasons = packet + TA_HEADER + TP_GUARDED_SIZE;
    tp_guarded m;
    m.position = position;
    m.reasons = NULL;
    m.reasons_size = 0;
    size_t size = tp_guarded_encode(&m, packet + TA_HEADER, TP_GUARDED_SIZE);
    for (size_t i = 0; i < amp->config.channels; i++) {
        reasons[i] = amp->guard.guards[i].reason;
    }
    ta_send(amp, TP_GUARDED, packet, size + amp->config.channels);
}

/* After the sample at `position` was put out; `come` says that the tick of START has come. */
static void correlate(ta_amplifier *amp, uint32_t position, bool come)
{
    int16_t currents[TA_CHANNELS];
    if (!ta_correlates(amp)) {
        return;
    }
    if (amp->state != TP_STATE_RUNNING || !come) {
        ta_correlator_stop(&amp->correlator);
        return;
    }
    if (!ta_correlator_played(&amp->correlator, amp->player.codes)) {
        return;
    }
    amp->hal.currents(amp->hal.context, currents);
    add_to_window(amp, position, currents);
    if (ta_guard_add(&amp->guard, &amp->correlator, currents)) {
        send_guarded(amp, position + 1u);
    }
}

/* The gains of the guards at this instant. */
static void move_guards(ta_amplifier *amp)
{
    if (amp->state == TP_STATE_RUNNING && !amp->start_pending) {
        amp->player.held_down = ta_guard_move(&amp->guard, amp->player.held);
    }
}

#else

bool ta_correlates(const ta_amplifier *amp)
{
    (void)amp;
    return false;
}

void ta_correlation_start(ta_amplifier *amp)
{
    (void)amp;
}

void ta_correlation_stop(ta_amplifier *amp)
{
    (void)amp;
}

static void correlate(ta_amplifier *amp, uint32_t position, bool come)
{
    (void)amp;
    (void)position;
    (void)come;
}

static void move_guards(ta_amplifier *amp)
{
    (void)amp;
}

#endif

/* States, section 6 */

static void switch_high_voltage(ta_amplifier *amp, bool on)
{
    if (amp->high_voltage != on) {
        amp->high_voltage = on;
        amp->hal.high_voltage(amp->hal.context, on);
    }
}

/* The high voltage that a state asks for, which goes off at 0 V only. */
static void settle_high_voltage(ta_amplifier *amp)
{
    bool on = amp->state == TP_STATE_ARMED || amp->state == TP_STATE_RUNNING ||
              amp->state == TP_STATE_RAMPDOWN;
    if (on || amp->player.silent) {
        switch_high_voltage(amp, on);
    }
}

static void enter(ta_amplifier *amp, uint8_t state)
{
    if (amp->state != state) {
        amp->state = state;
        amp->announce = true;
        amp->start_pending = amp->start_pending && state == TP_STATE_RUNNING; /* 7.1 */
        settle_high_voltage(amp);
    }
}

void ta_apply(ta_amplifier *amp, uint8_t entry)
{
    uint8_t state = entry & 7u;
    if ((entry & (TP_TABLE_STAYS | TP_TABLE_REFUSED)) != 0) {
        return;
    }
    if (state == TP_STATE_RAMPDOWN) {
        amp->then = (uint8_t)(entry >> 3 & 7u);
    }
    enter(amp, state);
}

void ta_fault(ta_amplifier *amp, uint8_t code, uint64_t now)
{
    char text[] = "fault 000";
    char *end = text + 6;
    ta_run(amp, now);
    amp->hardware_fault = code;
    if (code == TP_FAULT_NONE) {
        return;
    }
    amp->fault = code;
    amp->counters.trips++;
    ta_apply(amp, on_fault[amp->state]);
    if (!amp->announce) {
        return;
    }
    ta_announce(amp);
    if (code >= 100u) {
        *end++ = (char)('0' + code / 100u);
    }
    if (code >= 10u) {
        *end++ = (char)('0' + code / 10u % 10u);
    }
    *end++ = (char)('0' + code % 10u);
    *end = '\0';
    send_log(amp, TP_LOG_LEVEL_ERROR, text);
}

/* E-stop input, section 6.3: an opening acts at once, a closing when it has lasted. */
static void read_input(ta_amplifier *amp, uint64_t now)
{
    bool open = amp->hal.estop_open != NULL && amp->hal.estop_open(amp->hal.context);
    if (open == amp->contact_open) {
        return;
    }
    amp->contact_open = open;
    if (!open) {
        amp->contact_closed = now;
        return;
    }
    amp->contact_was_open = true;
    amp->estop_reason = TP_ESTOP_REASON_INPUT;
    amp->counters.trips++;
    ta_apply(amp, on_estop_input[amp->state]);
    if (amp->announce) {
        ta_announce(amp);
        send_log(amp, TP_LOG_LEVEL_ERROR, "e-stop input open");
    }
}

void ta_estop_input(ta_amplifier *amp, uint64_t now)
{
    ta_run(amp, now);
    read_input(amp, now);
}

bool ta_input_open(const ta_amplifier *amp, uint64_t now)
{
    bool settling = amp->contact_was_open && !ta_elapsed(now, amp->contact_closed, TP_INPUT_CLOSED_MS,
                                                         amp->config.tick_hz);
    return amp->contact_open || settling;
}

/* Section 6.2. It fires once: a HEARTBEAT or ARM sets it going again. */
static void watch(ta_amplifier *amp, uint64_t tick)
{
    bool runs = (on_watchdog[amp->state] & TP_TABLE_STAYS) == 0;
    if (!runs || !amp->watched ||
        !ta_elapsed(tick, amp->heartbeat, TP_WATCHDOG_MS, amp->config.tick_hz)) {
        return;
    }
    uint8_t then = amp->then;
    amp->watched = false;
    ta_apply(amp, on_watchdog[amp->state]);
    if (!amp->announce && amp->then == then) {
        return;
    }
    amp->counters.watchdogs++;
    ta_announce(amp);
    send_log(amp, TP_LOG_LEVEL_WARNING, "watchdog: no heartbeat");
}

/* Sample clock, section 7.1 */

/* One period on: base + floor(k x tick_hz / rate), by carrying the remainder. */
static void next_period(ta_amplifier *amp)
{
    amp->next += amp->period;
    amp->remainder += amp->period_rest;
    if (amp->remainder >= amp->player.rate) {
        amp->remainder -= amp->player.rate;
        amp->next++;
    }
}

static void set_base(ta_amplifier *amp, uint64_t base)
{
    amp->next = base;
    amp->remainder = 0;
    next_period(amp);
}

void ta_set_rate(ta_amplifier *amp, uint32_t rate, uint64_t now)
{
    if (amp->player.rate != rate) {
        amp->player.rate = rate;
        amp->period = amp->config.tick_hz / rate;
        amp->period_rest = amp->config.tick_hz % rate;
        set_base(amp, now);
    }
    derive(amp);
}

/* Whether the next instant is that of a START. */
static bool start_is_next(const ta_amplifier *amp)
{
    return amp->start_pending && amp->next >= amp->start_tick;
}

uint64_t ta_next_instant(const ta_amplifier *amp)
{
    return start_is_next(amp) ? amp->start_tick : amp->next;
}

static void advance_clock(ta_amplifier *amp)
{
    if (start_is_next(amp)) {
        amp->start_pending = false;
        set_base(amp, amp->start_tick);
    } else {
        next_period(amp);
    }
}

/* Actions at an instant */

static void pulse_if_due(ta_amplifier *amp, uint64_t tick)
{
    if (amp->session == 0) {
        return;
    }
    if (amp->pulse_now || ta_elapsed(tick, amp->pulse_tick, amp->pulse_ms, amp->config.tick_hz)) {
        amp->pulse_now = false;
        amp->pulse_tick = tick;
        send_pulse(amp);
    }
}

static void sense_if_due(ta_amplifier *amp, uint64_t tick)
{
    if (amp->sense_ms == 0) {
        return;
    }
    if (amp->sense_now || ta_elapsed(tick, amp->sense_tick, amp->sense_ms, amp->config.tick_hz)) {
        amp->sense_now = false;
        amp->sense_tick = tick;
        send_senses(amp);
    }
}

/* The sample, and the position after it. */
static void put_out(ta_amplifier *amp, uint64_t tick)
{
    ta_player *p = &amp->player;
    move_guards(amp);
    ta_player_instant(p, amp->state, !amp->start_pending);
    amp->last_position = p->position;
    amp->hal.put_out(amp->hal.context, tick, p->position, p->codes);
    correlate(amp, p->position, !amp->start_pending);
    ta_player_move(p, amp->start_pending);
}

/* Section 11.2: RAMPDOWN ends after the instant at which g and all outputs are 0. */
static void end_rampdown(ta_amplifier *amp)
{
    if (amp->state == TP_STATE_RAMPDOWN && amp->player.gain == 0 &&
        amp->player.silent) {
        enter(amp, amp->then);
    }
}

static void instant(ta_amplifier *amp)
{
    uint64_t tick = ta_next_instant(amp);
    advance_clock(amp);
    read_input(amp, tick);
    watch(amp, tick);
    pulse_if_due(amp, tick);
    sense_if_due(amp, tick);
    put_out(amp, tick);
    end_rampdown(amp);
    settle_high_voltage(amp);
    ta_announce(amp);
    if (amp->hal.after != NULL) {
        amp->hal.after(amp->hal.context, tick, amp->state, amp->high_voltage);
    }
}

void ta_run(ta_amplifier *amp, uint64_t now)
{
    while (ta_next_instant(amp) <= now) {
        instant(amp);
    }
}
