/* Requests: the checks of section 5 in their order, and the answers.
 *
 * A message has a rule, which says what is checked before it, and a function, which checks its values
 * and acts. The function gives a verdict: done, or why not; the answer follows from that.
 */
#include "tactile_internal.h"

typedef struct {
    ta_verdict (*act)(ta_amplifier *amp, const ta_request *r);
    uint8_t head;            /* bytes of the head of a message with a body */
    int8_t session;          /* offset in the payload; -1: not checked */
    bool answers;            /* with another message than ACK */
    bool locked;             /* its function is called within a lock */
    const uint8_t *by_state; /* row of the table of section 6, or NULL */
} rule;

const uint8_t ta_on_arm[] = TP_TABLE_ARM;
const uint8_t ta_on_start[] = TP_TABLE_START;
const uint8_t ta_on_stop[] = TP_TABLE_STOP;
const uint8_t ta_on_disarm[] = TP_TABLE_DISARM;
const uint8_t ta_on_estop[] = TP_TABLE_ESTOP;
const uint8_t ta_on_clear_fault[] = TP_TABLE_CLEAR_FAULT;
const uint8_t ta_on_limits[] = TP_TABLE_LIMITS;
const uint8_t ta_on_carriers[] = TP_TABLE_CARRIERS;

ta_verdict ta_refuse_as(ta_amplifier *amp, uint32_t *counter, uint8_t code, uint32_t detail)
{
    ++*counter;
    amp->refusal_detail = detail;
    return code;
}

ta_verdict ta_refuse(ta_amplifier *amp, uint8_t code, uint32_t detail)
{
    return ta_refuse_as(amp, &amp->counters.refused, code, detail);
}

ta_verdict ta_malformed(ta_amplifier *amp, const ta_request *r)
{
    return ta_refuse_as(amp, &amp->counters.malformed, TP_NAK_LENGTH, (uint32_t)r->packet.size);
}

ta_verdict ta_by_table(ta_amplifier *amp, const uint8_t *table)
{
    uint8_t entry = table[amp->state];
    if ((entry & TP_TABLE_REFUSED) != 0) {
        return ta_refuse(amp, entry & 0x7Fu, 0);
    }
    return TA_DONE;
}

static const rule rules[] = {
    [TP_HELLO] = {ta_act_hello, 0, -1, true, false, NULL},
    [TP_TIME] = {ta_act_time, 0, -1, true, false, NULL},
    [TP_SYNC] = {ta_act_sync, 0, -1, false, false, NULL},
    [TP_START] = {ta_act_start, 0, 0, false, false, NULL},
    [TP_STOP] = {ta_act_stop, 0, 0, false, true, ta_on_stop},
    [TP_ARM] = {ta_act_arm, 0, 0, false, true, ta_on_arm},
    [TP_DISARM] = {ta_act_disarm, 0, 0, false, true, ta_on_disarm},
    [TP_ESTOP] = {ta_act_estop, 0, -1, false, true, ta_on_estop},
    [TP_CLEAR_FAULT] = {ta_act_clear_fault, 0, 0, false, true, ta_on_clear_fault},
    [TP_HEARTBEAT] = {ta_act_heartbeat, 0, 0, false, true, NULL},
    [TP_LIMITS] = {ta_act_limits, 0, 0, false, true, ta_on_limits},
    [TP_GET] = {ta_act_get, 0, -1, true, false, NULL},
    [TP_SET] = {ta_act_set, 0, 0, false, false, NULL},
    [TP_IDENTIFY] = {ta_act_identify, 0, -1, false, false, NULL},
    [TP_POLL] = {ta_act_poll, 0, -1, true, false, NULL},
    [TP_PCM] = {ta_act_pcm, TP_PCM_SIZE, 4, false, false, NULL},
    [TP_CARRIERS] = {ta_act_carriers, TP_CARRIERS_SIZE, 0, false, true, ta_on_carriers},
    [TP_SPECTRUM] = {ta_act_spectrum, TP_SPECTRUM_SIZE, 4, false, false, NULL},
    [TP_GUARD] = {ta_act_guard, TP_GUARD_SIZE, 0, false, false, NULL},
    [TP_MARK] = {ta_act_mark, 0, 0, false, true, NULL},
};

/* Whether a message is of a feature that the board does not have. */
static bool lacks(const ta_amplifier *amp, uint8_t type)
{
    return (type == TP_GUARD && !ta_correlates(amp)) || (type == TP_MARK && !ta_has_markers(amp));
}

static bool owns(const ta_amplifier *amp, const ta_request *r, size_t at)
{
    uint16_t session = (uint16_t)tp_get_le(r->packet.payload, r->packet.size, at, 2);
    return session != 0 && session == amp->session;
}

/* Makes check 8, then check 9 of the message: no instant changes the state between them. */
static ta_verdict act_locked(ta_amplifier *amp, const ta_request *r, const rule *u)
{
    ta_lock(amp);
    ta_verdict v = u->by_state != NULL ? ta_by_table(amp, u->by_state) : TA_DONE;
    if (v == TA_DONE) {
        v = u->act(amp, r);
    }
    ta_unlock(amp);
    return v;
}

/* Makes checks 3 to 8, then check 9 of the message. */
static ta_verdict judge(ta_amplifier *amp, const ta_request *r)
{
    const ta_packet *p = &r->packet;
    bool any_flags = p->type == TP_ESTOP; /* its id and layout never change */
    if (!any_flags && p->flags >> 6 != TP_MAJOR) {
        return ta_refuse_as(amp, &amp->counters.wrong_version, TP_NAK_VERSION, TP_MAJOR);
    }
    if (!any_flags && (p->flags & TP_FLAG_INCOMPATIBLE) != 0) {
        return ta_refuse_as(amp, &amp->counters.unsupported, TP_NAK_UNSUPPORTED, p->flags);
    }
    bool known = p->type < sizeof rules / sizeof rules[0] && rules[p->type].act != NULL;
    if (!known || lacks(amp, p->type)) {
        return ta_refuse_as(amp, &amp->counters.unknown_type, TP_NAK_UNKNOWN_TYPE, 0);
    }
    const rule *u = &rules[p->type];
    if (p->size < u->head) {
        return ta_malformed(amp, r);
    }
    if (u->session >= 0 && !owns(amp, r, (size_t)u->session)) {
        return ta_refuse_as(amp, &amp->counters.foreign_session, TP_NAK_SESSION, 0);
    }
    return u->locked ? act_locked(amp, r, u) : u->act(amp, r);
}

static void answer(ta_amplifier *amp, const ta_request *r, ta_verdict v)
{
    uint8_t packet[TA_OVERHEAD + TP_NAK_SIZE];
    if (v != TA_DONE) {
        tp_nak m;
        m.type = r->packet.type;
        m.seq = r->packet.seq;
        m.code = v;
        m.state = amp->state;
        m.detail = amp->refusal_detail;
        ta_send(amp, TP_NAK, packet, tp_nak_encode(&m, packet + TA_HEADER, TP_NAK_SIZE));
    } else if (!rules[r->packet.type].answers) {
        tp_ack m;
        m.type = r->packet.type;
        m.seq = r->packet.seq;
        ta_send(amp, TP_ACK, packet, tp_ack_encode(&m, packet + TA_HEADER, TP_ACK_SIZE));
    }
}

/* Does everything from check 3 on; what has to wait for the answer comes last. */
static void handle(ta_amplifier *amp, const ta_request *r)
{
    amp->counters.packets++;
    if (!r->to_all && r->packet.node != amp->node) {
        return;
    }
    ta_verdict v = judge(amp, r);
    if (r->ack && !r->to_all) {
        answer(amp, r, v);
    }
    amp->node = amp->next_node;
    ta_lock(amp);
    ta_announce(amp);
    ta_unlock(amp);
    ta_serve(amp);
}

void ta_receive(ta_amplifier *amp, const uint8_t *packet, size_t size, uint64_t now)
{
    ta_request r;
    ta_catch_up(amp, now);
    if (size > amp->config.packet_limit) {
        amp->counters.oversized++;
    } else if (size < TA_OVERHEAD) {
        amp->counters.malformed++;
    } else if (!ta_packet_decode(&r.packet, packet, size)) {
        amp->counters.crc_errors++;
    } else {
        r.now = now;
        r.to_all = r.packet.node == 0;
        r.ack = (r.packet.flags & TP_FLAG_ACK_REQUEST) != 0;
        handle(amp, &r);
    }
}

void ta_receive_prompt(ta_amplifier *amp, uint8_t type, const uint8_t *payload, size_t size,
                       uint64_t now)
{
    ta_request r;
    ta_catch_up(amp, now);
    r.packet.type = type;
    r.packet.flags = (uint8_t)(TP_MAJOR << 6);
    r.packet.node = amp->node;
    r.packet.seq = 0;
    r.packet.payload = payload;
    r.packet.size = size;
    r.now = now;
    r.to_all = false;
    r.ack = false;
    handle(amp, &r);
}
