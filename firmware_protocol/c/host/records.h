/* Kinds of records: u64 tick, u8 kind, u32 length, bytes. They say what an amplifier was fed and what it sent, on
 * a virtual clock. */
#ifndef RECORDS_H
#define RECORDS_H

#define RECORD_HEAD 13u /* bytes before the content */

enum {
    KIND_SERIAL = 0,
    KIND_CAN = 1,
    KIND_I2C_WRITE = 2,
    KIND_PACKET = 3,
    KIND_NOTHING = 4,
    KIND_FAULT = 5,
    KIND_I2C_READ = 6,
    KIND_SMBUS_WRITE = 7,
    KIND_SMBUS_READ = 8,
    KIND_ESTOP_INPUT = 9,
    KIND_HIGH_VOLTAGE = 10, /* of what was sent: the HAL has switched it */

    /* Only between a test and an emulated microcontroller (ports/qemu/wire.c): */
    KIND_POWER_UP = 11,
    KIND_PUT_OUT = 12, /* functions of the HAL, from here on */
    KIND_AFTER = 13,
    KIND_CURRENTS = 14,
    KIND_SENSE = 15,
    KIND_SENSE_RANGE = 16,
    KIND_DONE = 17, /* all has been done that the latest record demanded */

    KIND_MARKS = 18 /* of what was sent, and of an emulated part: the HAL has set the marker lines */
};

#endif
