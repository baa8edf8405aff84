/* Limits and parameters, and what the amplifier tells of itself: CAPS, STATUS and VALUE. */
#include "tactile_internal.h"

void ta_send_caps(ta_amplifier *amp)
{
    uint8_t packet[TA_OVERHEAD + TP_CAPS_SIZE];
    const ta_config *c = &amp->config;
    tp_caps m;
    m.session = amp->session;
    m.major = TP_MAJOR;
    m.minor = TP_MINOR;
    m.schema = TP_SCHEMA_CRC;
    m.channels = c->channels;
    m.carriers = c->carriers;
    m.formats = c->formats;
    m.features = (uint16_t)((amp->hal.sense != NULL ? TP_FEATURE_SENSES : 0) |
                            (amp->hal.estop_open != NULL ? TP_FEATURE_ESTOP_INPUT : 0) |
                            (ta_correlates(amp) ? TP_FEATURE_CORRELATES | TP_FEATURE_GUARDS : 0) |
                            (c->holds ? TP_FEATURE_ZERO_ORDER_HOLD : 0));
    m.packet_limit = c->packet_limit;
    m.fifo_samples = c->fifo_samples;
    m.tick_hz = c->tick_hz;
    m.rate_min_hz = c->rate_min_hz;
    m.rate_max_hz = c->rate_max_hz;
    m.full_scale_uv = c->full_scale_uv;
    m.voltage_limit_uv = c->voltage_limit_uv;
    m.slew_limit_v_per_s = c->slew_limit_v_per_s;
    m.fade_limit_us = c->fade_limit_us;
    m.firmware = c->firmware;
    memcpy(m.name, c->name, sizeof m.name);
    m.marker_lines = c->marker_lines;
    ta_send(amp, TP_CAPS, packet, tp_caps_encode(&m, packet + TA_HEADER, TP_CAPS_SIZE));
}

static uint32_t lower(uint32_t asked, uint32_t in_force)
{
    return asked != 0 ? asked : in_force;
}

/* A lower slew limit would lengthen a way to 0 V that has begun: refused until it is over. */
ta_verdict ta_act_limits(ta_amplifier *amp, const ta_request *r)
{
    tp_limits m;
    (void)tp_limits_decode(&m, r->packet.payload, r->packet.size);
    if (!amp->player.silent) {
        return ta_refuse(amp, TP_NAK_STATE, 0);
    }
    if (m.voltage_uv > amp->voltage_uv) {
        return ta_refuse(amp, TP_NAK_RANGE, 1);
    }
    if (m.slew_v_per_s > amp->slew_v_per_s) {
        return ta_refuse(amp, TP_NAK_RANGE, 2);
    }
    if (m.fade_us > amp->fade_us) {
        return ta_refuse(amp, TP_NAK_RANGE, 3);
    }
    uint32_t voltage = lower(m.voltage_uv, amp->voltage_uv);
    uint32_t slew = lower(m.slew_v_per_s, amp->slew_v_per_s);
    if (!ta_reach_zero(&amp->config, voltage, slew, amp->player.rate)) {
        return ta_refuse(amp, TP_NAK_RANGE, 2);
    }
    ta_limit(amp, voltage, slew, lower(m.fade_us, amp->fade_us));
    return TA_DONE;
}

/* A parameter's value; false where this amplifier does not have it. */
static bool parameter_get(ta_amplifier *amp, uint16_t id, uint64_t now, uint32_t *value)
{
    const ta_hal *hal = &amp->hal;
    switch (id) {
    case TP_PARAMETER_NODE:
        *value = amp->node;
        return true;
    case TP_PARAMETER_PULSE_MS:
        *value = amp->pulse_ms;
        return true;
    case TP_PARAMETER_SENSE_MS:
        *value = amp->sense_ms;
        return hal->sense != NULL;
    case TP_PARAMETER_LOG_LEVEL:
        *value = amp->log_level;
        return true;
    case TP_PARAMETER_UPTIME_S:
        *value = (uint32_t)(now / amp->config.tick_hz);
        return true;
    case TP_PARAMETER_HIGH_VOLTAGE_MV:
        return hal->supply_mv != NULL && hal->supply_mv(hal->context, value);
    case TP_PARAMETER_TEMPERATURE_MK:
        return hal->temperature_mk != NULL && hal->temperature_mk(hal->context, value);
    case TP_PARAMETER_CORRELATION_MS:
        *value = amp->correlation_ms;
        return ta_correlates(amp);
    case TP_PARAMETER_SENSE_RANGE_UA:
        *value = amp->sense_range_ua;
        return ta_correlates(amp);
    default:
        return false;
    }
}

/* The parameters that can only be read. */
static bool read_only(uint16_t id)
{
    return id == TP_PARAMETER_UPTIME_S || id == TP_PARAMETER_HIGH_VOLTAGE_MV ||
           id == TP_PARAMETER_TEMPERATURE_MK;
}

/* A change ends the window under way (16.2). */
static bool correlation_set(ta_amplifier *amp, uint32_t value)
{
    if (value != 0 && (value < 10 || value > 100)) {
        return false;
    }
    if (value != amp->correlation_ms) {
        ta_correlation_stop(amp);
    }
    amp->correlation_ms = value;
    return true;
}

static bool range_set(ta_amplifier *amp, uint32_t value)
{
    if (value == amp->sense_range_ua) {
        return true;
    }
    if (value == 0 || value > UINT16_MAX || amp->hal.sense_range == NULL ||
        !amp->hal.sense_range(amp->hal.context, (uint16_t)value)) {
        return false;
    }
    ta_correlation_stop(amp);
    amp->sense_range_ua = (uint16_t)value;
    return true;
}

/* False: out of range. */
static bool parameter_set(ta_amplifier *amp, uint16_t id, uint32_t value)
{
    switch (id) {
    case TP_PARAMETER_NODE:
        if (value < 1 || value > 127) {
            return false;
        }
        amp->next_node = (uint8_t)value;
        return true;
    case TP_PARAMETER_PULSE_MS:
        if (value < 1 || value > 100) {
            return false;
        }
        amp->pulse_ms = value;
        return true;
    case TP_PARAMETER_SENSE_MS:
        if (value != 0 && (value < 10 || value > 1000)) {
            return false;
        }
        amp->sense_now = amp->sense_now || amp->sense_ms == 0;
        amp->sense_ms = value;
        return true;
    case TP_PARAMETER_CORRELATION_MS:
        return correlation_set(amp, value);
    case TP_PARAMETER_SENSE_RANGE_UA:
        return range_set(amp, value);
    default:
        if (value > TP_LOG_LEVEL_OFF) {
            return false;
        }
        amp->log_level = value;
        return true;
    }
}

ta_verdict ta_act_get(ta_amplifier *amp, const ta_request *r)
{
    uint8_t packet[TA_OVERHEAD + TP_VALUE_SIZE];
    tp_get m;
    tp_value reply;
    (void)tp_get_decode(&m, r->packet.payload, r->packet.size);
    reply.parameter = m.parameter;
    reply.value = 0;
    if (!parameter_get(amp, m.parameter, r->now, &reply.value)) {
        return ta_refuse(amp, TP_NAK_PARAMETER, m.parameter);
    }
    if (!r->to_all) {
        ta_send(amp, TP_VALUE, packet,
                tp_value_encode(&reply, packet + TA_HEADER, TP_VALUE_SIZE));
    }
    return TA_DONE;
}

/* Whether NODE may be set: not while something can play, nor of all amplifiers at once. */
static bool may_move(const ta_amplifier *amp, const ta_request *r)
{
    return !r->to_all && (amp->state == TP_STATE_IDLE || amp->state == TP_STATE_SAFE);
}

ta_verdict ta_act_set(ta_amplifier *amp, const ta_request *r)
{
    uint32_t present;
    tp_set m;
    (void)tp_set_decode(&m, r->packet.payload, r->packet.size);
    if (!parameter_get(amp, m.parameter, r->now, &present)) {
        return ta_refuse(amp, TP_NAK_PARAMETER, m.parameter);
    }
    if (read_only(m.parameter)) {
        return ta_refuse(amp, TP_NAK_READ_ONLY, m.parameter);
    }
    if (m.parameter == TP_PARAMETER_NODE && !may_move(amp, r)) {
        return ta_refuse(amp, TP_NAK_STATE, 0);
    }
    ta_lock(amp);
    bool in_range = parameter_set(amp, m.parameter, m.value);
    ta_unlock(amp);
    return in_range ? TA_DONE : ta_refuse(amp, TP_NAK_RANGE, 2);
}

ta_verdict ta_act_identify(ta_amplifier *amp, const ta_request *r)
{
    tp_identify m;
    (void)tp_identify_decode(&m, r->packet.payload, r->packet.size);
    if (amp->hal.identify != NULL) {
        amp->hal.identify(amp->hal.context, m.seconds);
    }
    return TA_DONE;
}

/* STATUS has the counters in the order of ta_counters, and nothing between them. */
TA_ASSERT(counters, offsetof(tp_status, trips) - offsetof(tp_status, packets) ==
                        offsetof(ta_counters, trips) - offsetof(ta_counters, packets));

ta_verdict ta_act_poll(ta_amplifier *amp, const ta_request *r)
{
    uint8_t packet[TA_OVERHEAD + TP_STATUS_SIZE];
    tp_status m;
    if (r->to_all) {
        return TA_DONE;
    }
    ta_lock(amp);
    m.state = amp->state;
    m.phase = ta_phase(amp);
    m.fault = amp->fault;
    m.estop_reason = amp->estop_reason;
    m.session = amp->session;
    m.position = amp->player.position;
    m.time = amp->start_pending ? amp->start_tick : ta_next_instant(amp);
    m.sync_index = amp->sync_index;
    m.sync_time = amp->sync_tick;
    m.voltage_limit_uv = amp->voltage_uv;
    m.slew_limit_v_per_s = amp->slew_v_per_s;
    m.fade_us = amp->fade_us;
    memcpy((uint8_t *)&m + offsetof(tp_status, packets), &amp->counters, sizeof amp->counters);
    m.inputs = ta_input_open(amp, r->now) ? TP_INPUT_ESTOP_OPEN : 0;
    ta_unlock(amp);
    ta_send(amp, TP_STATUS, packet, tp_status_encode(&m, packet + TA_HEADER, TP_STATUS_SIZE));
    return TA_DONE;
}
