/* Links; see the header. */
#include "tactile_link.h"

/* Serial */

void ta_serial_init(ta_serial *link, ta_amplifier *amp,
                    bool (*write)(void *context, const uint8_t *bytes, size_t size),
                    void *context)
{
    link->amp = amp;
    link->write = write;
    link->context = context;
    ta_cobs_init(&link->cobs, amp->config.packet_limit);
}

void ta_serial_feed(ta_serial *link, const uint8_t *bytes, size_t size, uint64_t now)
{
    ta_cobs_event event;
    while (size > 0) {
        size_t taken = ta_cobs_feed(&link->cobs, bytes, size, &event);
        bytes += taken;
        size -= taken;
        switch (event) {
        case TA_COBS_FRAME:
            ta_receive(link->amp, link->cobs.bytes, link->cobs.frame, now);
            break;
        case TA_COBS_MALFORMED:
            link->amp->counters.malformed++;
            break;
        case TA_COBS_OVERSIZED:
            link->amp->counters.oversized++;
            break;
        default:
            break;
        }
    }
}

bool ta_serial_send(ta_serial *link, const uint8_t *packet, size_t size)
{
    uint8_t coded[TA_COBS_MAX(TA_REPLY_MAX) + 1u];
    size_t length = ta_cobs_encode(packet, size, coded);
    coded[length] = 0;
    return link->write(link->context, coded, length + 1u);
}

/* CAN */

#define CAN_ID_MASK 0x7FFu
#define START_PROMPT 7u /* bytes of START that a prompt frame has */

void ta_can_init(ta_can *link, ta_amplifier *amp, bool fd, bool extended,
                 bool (*write)(void *context, const ta_can_frame *frame), void *context)
{
    memset(link, 0, sizeof *link);
    link->amp = amp;
    link->fd = fd;
    link->extended = extended;
    link->write = write;
    link->context = context;
    ta_reassembly_init(&link->reassembly, amp->config.packet_limit, amp->config.tick_hz,
                       &amp->counters.fragments_dropped);
}

/* What identifiers begin with. */
static uint32_t prefix(const ta_can *link)
{
    return link->extended ? TP_CAN_PREFIX : 0u;
}

/* SYNC, START and HEARTBEAT; any other type is unknown here. */
static void prompt(ta_amplifier *amp, const ta_can_frame *frame, uint64_t now)
{
    size_t size = frame->size;
    if (size == 0) {
        amp->counters.malformed++;
        return;
    }
    uint8_t type = frame->data[0];
    size--;
    if (type != TP_SYNC && type != TP_START && type != TP_HEARTBEAT) {
        amp->counters.unknown_type++;
        return;
    }
    if (type == TP_START && size > START_PROMPT) {
        size = START_PROMPT;
    }
    ta_receive_prompt(amp, type, frame->data + 1, size, now);
}

static void fragment(ta_can *link, const ta_can_frame *frame, uint64_t now)
{
    const ta_transfer *t = ta_reassembly_feed(&link->reassembly, frame->id, frame->data,
                                              frame->size, frame->size > 8u, now);
    if (t != NULL) {
        ta_receive(link->amp, t->bytes, t->size, now);
    }
}

void ta_can_feed(ta_can *link, const ta_can_frame *frame, uint64_t now)
{
    ta_amplifier *amp = link->amp;
    uint32_t node = frame->id >> 1 & 0x7Fu;
    bool from_host = (frame->id & 1u) == 0;
    if (frame->extended != link->extended || (frame->id & ~CAN_ID_MASK) != prefix(link) ||
        !from_host || (node != 0 && node != amp->node)) {
        return;
    }
    switch (frame->id >> 8 & 7u) {
    case TP_CAN_CLASS_ESTOP:
        ta_receive_prompt(amp, TP_ESTOP, frame->data, frame->size, now);
        break;
    case TP_CAN_CLASS_PROMPT:
        prompt(amp, frame, now);
        break;
    case TP_CAN_CLASS_STREAM:
    case TP_CAN_CLASS_REQUEST:
        fragment(link, frame, now);
        break;
    default: /* no class of the host's */
        break;
    }
}

/* Bytes beyond the content, up to a length that FD has, are zeros. */
static bool can_write(ta_can *link, uint8_t kind, ta_can_frame *frame, size_t size)
{
    size_t length = link->fd ? ta_can_fd_length(size) : size;
    frame->id = prefix(link) | (uint32_t)kind << 8 | (uint32_t)link->amp->node << 1 | 1u;
    frame->extended = link->extended;
    frame->fd = link->fd;
    frame->size = (uint8_t)length;
    memset(frame->data + size, 0, length - size);
    return link->write(link->context, frame);
}

static bool can_transfer(ta_can *link, uint8_t kind, const uint8_t *packet, size_t size)
{
    uint8_t *id = &link->ids[kind - TP_CAN_CLASS_RESPONSE];
    size_t room = link->fd ? 64u : 8u;
    ta_can_frame frame;
    ta_cutter cutter = {0};
    cutter.packet = packet;
    cutter.size = size;
    cutter.id = *id;
    *id = (uint8_t)((*id + 1u) & TA_FRAGMENT_ID);
    for (;;) {
        size_t part = ta_cut(&cutter, frame.data, room);
        if (part == 0) {
            return true;
        }
        if (!can_write(link, kind, &frame, part)) {
            return false;
        }
    }
}

bool ta_can_send(ta_can *link, const uint8_t *packet, size_t size)
{
    ta_can_frame frame;
    switch (packet[0]) {
    case TP_PULSE:
        memcpy(frame.data, packet + TA_HEADER, TP_PULSE_SIZE);
        return can_write(link, TP_CAN_CLASS_PULSE, &frame, TP_PULSE_SIZE);
    case TP_SENSE:
    case TP_LOG:
    case TP_CORRELATION:
    case TP_MARKED:
        return can_transfer(link, TP_CAN_CLASS_BULK, packet, size);
    default:
        return can_transfer(link, TP_CAN_CLASS_RESPONSE, packet, size);
    }
}

/* Replies that wait */

static uint8_t waiting_byte(const ta_replies *r, size_t at)
{
    return r->bytes[(r->head + at) % TA_REPLIES];
}

static void push_byte(ta_replies *r, uint8_t byte)
{
    r->bytes[(r->head + r->used) % TA_REPLIES] = byte;
    r->used++;
}

bool ta_replies_push(ta_replies *r, const uint8_t *packet, size_t size)
{
    if (size + 2u > TA_REPLIES - r->used) {
        return false;
    }
    push_byte(r, (uint8_t)size);
    push_byte(r, (uint8_t)(size >> 8));
    for (size_t i = 0; i < size; i++) {
        push_byte(r, packet[i]);
    }
    return true;
}

bool ta_replies_waiting(const ta_replies *r)
{
    return r->used > 0;
}

/* Bytes of the first reply with its length, 0 where nothing waits. */
static size_t first_reply(const ta_replies *r)
{
    return r->used == 0 ? 0 : 2u + waiting_byte(r, 0) + ((size_t)waiting_byte(r, 1) << 8);
}

static void forget(ta_replies *r, size_t size)
{
    r->head = (r->head + size) % TA_REPLIES;
    r->used -= size;
}

/* I2C */

void ta_i2c_write(ta_amplifier *amp, const uint8_t *bytes, size_t size, uint64_t now)
{
    ta_receive(amp, bytes, size, now);
}

size_t ta_i2c_read(ta_replies *r, uint8_t *out, size_t size)
{
    size_t reply = first_reply(r);
    size_t given = reply > 0 ? reply : 2u;
    given = given < size ? given : size;
    for (size_t i = 0; i < given; i++) {
        out[i] = reply > 0 ? waiting_byte(r, i) : 0;
    }
    if (given == reply) {
        forget(r, reply);
    }
    return given;
}

void ta_smbus_init(ta_smbus *link, ta_amplifier *amp, ta_replies *replies)
{
    memset(link, 0, sizeof *link);
    link->amp = amp;
    link->replies = replies;
    link->cutter.started = true; /* nothing is left of it */
    ta_reassembly_init(&link->reassembly, amp->config.packet_limit, amp->config.tick_hz,
                       &amp->counters.fragments_dropped);
}

void ta_smbus_write(ta_smbus *link, const uint8_t *block, size_t size, uint64_t now)
{
    const ta_transfer *t = ta_reassembly_feed(&link->reassembly, 0, block, size, false, now);
    if (t != NULL) {
        ta_receive(link->amp, t->bytes, t->size, now);
    }
}

/* Takes the next reply into the cutter. */
static bool fetch(ta_smbus *link)
{
    size_t reply = first_reply(link->replies);
    if (reply == 0) {
        return false;
    }
    for (size_t i = 2; i < reply; i++) {
        link->packet[i - 2u] = waiting_byte(link->replies, i);
    }
    forget(link->replies, reply);
    memset(&link->cutter, 0, sizeof link->cutter);
    link->cutter.packet = link->packet;
    link->cutter.size = reply - 2u;
    link->cutter.id = link->id;
    link->id = (uint8_t)((link->id + 1u) & TA_FRAGMENT_ID);
    return true;
}

size_t ta_smbus_read(ta_smbus *link, uint8_t out[TA_SMBUS_BLOCK])
{
    size_t part = ta_cut(&link->cutter, out, TA_SMBUS_BLOCK);
    if (part == 0 && fetch(link)) {
        part = ta_cut(&link->cutter, out, TA_SMBUS_BLOCK);
    }
    if (part == 0) {
        out[0] = 0;
        part = 1;
    }
    return part;
}
