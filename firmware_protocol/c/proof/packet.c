/* Contracts of packets and COBS, which WP proves for all sizes. */
#include "../tactile_packet.h"

/* Loops of a constant number of turns, which the drivers of EVA go through. */

/*@ requires size <= 8 && \valid(out + (0 .. size - 1));
    assigns out[0 .. size - 1] \from value; */
static void tp_put_le(uint8_t *out, uint64_t value, size_t size);

/*@ requires at <= length && size <= 8 && \valid_read(in + (0 .. length - 1));
    assigns \nothing; */
static uint64_t tp_get_le(const uint8_t *in, size_t length, size_t at, size_t size);

/*@ requires \valid_read(bytes + (0 .. size - 1));
    assigns \nothing; */
uint32_t ta_crc32(const uint8_t *bytes, size_t size);

/*@ requires \valid(packet) && \valid_read(bytes + (0 .. size - 1));
    requires \separated(packet, bytes + (0 .. size - 1));
    assigns *packet;
    ensures \result ==> size >= 8 && packet->payload == bytes + 4 && packet->size == size - 8; */
bool ta_packet_decode(ta_packet *packet, const uint8_t *bytes, size_t size);

/*@ requires packet->size <= TA_REPLY_MAX - TA_OVERHEAD;
    requires \valid_read(packet) && \valid(bytes + (0 .. packet->size + 7));
    requires \initialized(bytes + (4 .. packet->size + 3));
    requires \separated(packet, bytes + (0 .. packet->size + 7));
    assigns bytes[0 .. packet->size + 7];
    ensures \result == packet->size + 8; */
size_t ta_packet_seal(uint8_t *bytes, const ta_packet *packet);

/*@ requires size <= TA_REPLY_MAX;
    requires \valid_read(in + (0 .. size - 1)) && \valid(out + (0 .. TA_COBS_MAX(size) - 1));
    requires \separated(in + (0 .. size - 1), out + (0 .. TA_COBS_MAX(size) - 1));
    assigns out[0 .. TA_COBS_MAX(size) - 1];
    ensures size < \result <= TA_COBS_MAX(size); */
size_t ta_cobs_encode(const uint8_t *in, size_t size, uint8_t *out);

/*@ requires \valid(cobs);
    requires limit <= TA_PACKET_MAX;
    assigns *cobs;
    ensures ta_cobs_holds(cobs) && cobs->limit == limit; */
void ta_cobs_init(ta_cobs *cobs, size_t limit);

/*@ requires \valid(cobs);
    assigns cobs->size, cobs->left, cobs->begun, cobs->zero, cobs->skip;
    ensures cobs->size == 0 && cobs->left == 0 && !cobs->begun && !cobs->zero && !cobs->skip; */
static void cobs_restart(ta_cobs *cobs);

/*@ requires \valid(cobs) && ta_cobs_holds(cobs);
    assigns cobs->frame, cobs->size, cobs->left, cobs->begun, cobs->zero, cobs->skip;
    ensures ta_cobs_holds(cobs) && cobs->frame == \old(cobs->size);
    ensures TA_COBS_MORE <= \result <= TA_COBS_OVERSIZED; */
static ta_cobs_event cobs_delimiter(ta_cobs *cobs);

/*@ requires \valid(cobs) && ta_cobs_holds(cobs) && code >= 1;
    assigns cobs->bytes[0 .. TA_PACKET_MAX - 1], cobs->size, cobs->left, cobs->begun, cobs->zero, cobs->skip;
    ensures ta_cobs_holds(cobs); */
static void cobs_code(ta_cobs *cobs, uint8_t code);

/*@ requires \valid(cobs) && ta_cobs_holds(cobs) && size >= 1 && cobs->left >= 1 && bytes[0] != 0;
    requires \valid_read(bytes + (0 .. size - 1)) && \separated(cobs, bytes + (0 .. size - 1));
    assigns cobs->bytes[0 .. TA_PACKET_MAX - 1], cobs->size, cobs->left, cobs->skip;
    ensures ta_cobs_holds(cobs) && \result <= size && (\result >= 1 || cobs->skip); */
static size_t cobs_block(ta_cobs *cobs, const uint8_t *bytes, size_t size);

/*@ requires \valid(cobs) && \valid(event) && \valid_read(bytes + (0 .. size - 1)) && ta_cobs_holds(cobs);
    requires \separated(cobs, event, bytes + (0 .. size - 1));
    assigns *cobs, *event;
    ensures ta_cobs_holds(cobs) && cobs->limit == \old(cobs->limit);
    ensures \result <= size && (size > 0 ==> \result > 0 || (*event == TA_COBS_OVERSIZED && cobs->skip));
    ensures *event == TA_COBS_FRAME ==> cobs->frame <= cobs->limit; */
size_t ta_cobs_feed(ta_cobs *cobs, const uint8_t *bytes, size_t size, ta_cobs_event *event);

#include "../tactile_packet.c"
