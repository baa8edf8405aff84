/* The links of section 3, between bytes or frames of the wire and packets of the amplifier.
 *
 * Firmware has the struct of its own link only. It feeds what it receives to the link. To send, the
 * HAL's `send` calls ta_serial_send or ta_can_send, or ta_replies_push on a bus where the host reads.
 *
 * All of it belongs to the loop: no two calls may overlap. An interrupt in which the part answers reads of I2C
 * is held off around what the loop calls, and one that receives puts bytes into a ring for the loop.
 */
#ifndef TACTILE_LINK_H
#define TACTILE_LINK_H

#include "tactile_amplifier.h"
#include "tactile_fragment.h"

/* Serial: UART, USB CDC, TCP (3.1). */
typedef struct {
    ta_amplifier *amp;
    bool (*write)(void *context, const uint8_t *bytes, size_t size); /* all, or false */
    void *context;
    ta_cobs cobs;
} ta_serial;

void ta_serial_init(ta_serial *link, ta_amplifier *amp,
                    bool (*write)(void *context, const uint8_t *bytes, size_t size),
                    void *context);
void ta_serial_feed(ta_serial *link, const uint8_t *bytes, size_t size, uint64_t now);
bool ta_serial_send(ta_serial *link, const uint8_t *packet, size_t size);

/* CAN and CAN FD (3.2). */
typedef struct {
    uint32_t id;
    bool extended; /* 29-bit identifier */
    bool fd;
    uint8_t size;
    uint8_t data[64];
} ta_can_frame;

typedef struct {
    ta_amplifier *amp;
    bool fd;       /* send FD frames */
    bool extended; /* identifiers have 29 bits */
    bool (*write)(void *context, const ta_can_frame *frame);
    void *context;
    uint8_t ids[2]; /* ids of the next transfers of RESPONSE and BULK */
    ta_reassembly reassembly;
} ta_can;

/* Handles a frame; one whose identifier has another length than `extended` says is ignored. */
void ta_can_init(ta_can *link, ta_amplifier *amp, bool fd, bool extended,
                 bool (*write)(void *context, const ta_can_frame *frame), void *context);
void ta_can_feed(ta_can *link, const ta_can_frame *frame, uint64_t now);
bool ta_can_send(ta_can *link, const uint8_t *packet, size_t size);

/* Packets that wait until the host reads them, first in first out, each after its length. */
typedef struct {
    uint8_t bytes[TA_REPLIES];
    size_t head;
    size_t used;
} ta_replies;

/* Appends a packet, for the HAL's `send`; returns false if there is no room. */
bool ta_replies_push(ta_replies *replies, const uint8_t *packet, size_t size);
bool ta_replies_waiting(const ta_replies *replies); /* for the line that is low meanwhile */

/* Raw transfers on I2C (3.3). A read gives at most `size` bytes and returns their number. */
void ta_i2c_write(ta_amplifier *amp, const uint8_t *bytes, size_t size, uint64_t now);
size_t ta_i2c_read(ta_replies *replies, uint8_t *out, size_t size);

/* SMBus block transfers on I2C: the bytes after command and count. */
#define TA_SMBUS_WRITE 0x54u
#define TA_SMBUS_READ 0x55u
#define TA_SMBUS_BLOCK 32u

typedef struct {
    ta_amplifier *amp;
    ta_replies *replies;
    uint8_t id;                   /* id of the next transfer to the host */
    ta_cutter cutter;             /* reply that is being read */
    uint8_t packet[TA_REPLY_MAX]; /* its bytes */
    ta_reassembly reassembly;
} ta_smbus;

void ta_smbus_init(ta_smbus *link, ta_amplifier *amp, ta_replies *replies);
void ta_smbus_write(ta_smbus *link, const uint8_t *block, size_t size, uint64_t now);
size_t ta_smbus_read(ta_smbus *link, uint8_t out[TA_SMBUS_BLOCK]);

#endif
