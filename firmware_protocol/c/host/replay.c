/* Records on a virtual clock: u64 tick, u8 kind, u32 length, bytes. The same records give the same
 * files, whatever the machine. */
#include <stdio.h>
#include <stdlib.h>

#include "virtual_amplifier.h"

#define LONGEST (1u << 20) /* bytes of a record */

/* Answers go over the link of the last record fed that has one. */
static void choose_link(virtual_amplifier *v, uint8_t kind)
{
    if (v->fixed_link || kind == KIND_NOTHING || kind == KIND_FAULT ||
        kind == KIND_ESTOP_INPUT) {
        return;
    }
    v->link = kind;
}

static void feed_frame(virtual_amplifier *v, const uint8_t *bytes, size_t size)
{
    uint32_t id = (uint32_t)tp_get_le(bytes, size, 0, 4);
    if (size >= 4u) {
        (void)virtual_feed_frame(v, id, size > 4u + 8u, bytes + 4, size - 4u);
    }
}

static void feed_read(virtual_amplifier *v, const uint8_t *bytes, size_t size)
{
    static uint8_t reply[65536];
    size_t asked = (size_t)tp_get_le(bytes, size, 0, 2);
    virtual_record(v, KIND_I2C_WRITE, reply, ta_i2c_read(&v->replies, reply, asked));
}

static void feed_block_read(virtual_amplifier *v)
{
    uint8_t block[TA_SMBUS_BLOCK];
    virtual_record(v, KIND_SMBUS_READ, block, ta_smbus_read(&v->smbus, block));
}

static void feed(virtual_amplifier *v, uint8_t kind, const uint8_t *bytes, size_t size)
{
    choose_link(v, kind);
    switch (kind) {
    case KIND_SERIAL:
        ta_serial_feed(&v->serial, bytes, size, v->tick);
        break;
    case KIND_CAN:
        feed_frame(v, bytes, size);
        break;
    case KIND_I2C_WRITE:
        ta_i2c_write(&v->amp, bytes, size, v->tick);
        break;
    case KIND_PACKET:
        ta_receive(&v->amp, bytes, size, v->tick);
        break;
    case KIND_FAULT:
        ta_fault(&v->amp, size > 0 ? bytes[0] : 0, v->tick);
        break;
    case KIND_I2C_READ:
        feed_read(v, bytes, size);
        break;
    case KIND_SMBUS_WRITE:
        ta_smbus_write(&v->smbus, bytes, size, v->tick);
        break;
    case KIND_SMBUS_READ:
        feed_block_read(v);
        break;
    case KIND_ESTOP_INPUT:
        v->estop_open = size > 0 && bytes[0] != 0;
        ta_estop_input(&v->amp, v->tick);
        break;
    default:
        break;
    }
}

bool virtual_replay(virtual_amplifier *v, FILE *records)
{
    static uint8_t bytes[LONGEST];
    uint8_t head[RECORD_HEAD];
    size_t got;
    while ((got = fread(head, 1, sizeof head, records)) == sizeof head) {
        uint64_t tick = tp_get_le(head, sizeof head, 0, 8);
        size_t size = (size_t)tp_get_le(head, sizeof head, 9, 4);
        if (size > LONGEST || head[8] > KIND_ESTOP_INPUT || tick < v->tick ||
            fread(bytes, 1, size, records) != size) {
            got = 1;
            break;
        }
        virtual_run(v, tick);
        feed(v, head[8], bytes, size);
    }
    if (got != 0) {
        fprintf(stderr, "virtual-amplifier: a record is cut off, of unknown kind or back in time\n");
    }
    return got == 0;
}
