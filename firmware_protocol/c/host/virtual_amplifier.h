/* The amplifier on a computer: what the three ways to run it share. */
#ifndef VIRTUAL_AMPLIFIER_H
#define VIRTUAL_AMPLIFIER_H

#include <stdio.h>

#include "../tactile_link.h"
#include "records.h"

#define VIRTUAL_OUT_BYTES 65536u /* of records that wait to be written, at most */
#define VIRTUAL_ID_EXTENDED 0x80000000u /* of identifiers, as SocketCAN has them */
#define VIRTUAL_ID_REMOTE 0x40000000u
#define VIRTUAL_LOAD_MAX 1000000u /* pF, of a channel's load */
#define VIRTUAL_SHORT (VIRTUAL_LOAD_MAX + 1u)
#define VIRTUAL_RANGES 8 /* of the current, at most */

typedef struct {
    ta_config config;
    const char *out;
    const char *sent;
    const char *can_path;
    const char *can_interface;
    int link; /* kind of record for answers, -1: as the last that was fed */
    bool fd;
    bool extended;
    bool senses;
    bool loaded; /* SENSE tells what it draws: */
    uint32_t load_pf[TA_CHANNELS];
    uint16_t ranges_ua[VIRTUAL_RANGES]; /* of the current; all 0: no CORRELATION */
    bool pty;
    bool replay;
} virtual_options;

/* One struct of everything: there is one amplifier in the program. */
typedef struct {
    ta_amplifier amp;
    ta_serial serial;
    ta_can can;
    ta_smbus smbus;
    ta_replies replies;
    uint64_t tick;
    uint8_t link;
    bool fixed_link;
    bool loaded;
    uint32_t load_pf[TA_CHANNELS];
    uint16_t ranges_ua[VIRTUAL_RANGES]; /* that it has, and the one in use */
    uint16_t range_ua;
    int16_t codes[2][TA_CHANNELS]; /* put out last, and before */
    bool estop_open;               /* the contact of the e-stop input */
    FILE *out;
    FILE *sent;
    size_t unflushed; /* bytes that wait for `out`, and the tick of the last that did not */
    uint64_t flushed;
    char waiting[VIRTUAL_OUT_BYTES];
    uint8_t row[16 + 2 * TA_CHANNELS]; /* the record of the instant under way */
    /* Where real links write to; NULL: into `sent` only. */
    bool (*write_bytes)(void *context, const uint8_t *bytes, size_t size);
    bool (*write_frame)(void *context, const ta_can_frame *frame);
    void *wire;
} virtual_amplifier;

/* Options of the command line; false, and a message, where one is wrong. */
bool virtual_parse(virtual_options *options, int argc, char **argv);

/* Says on stderr which option SPEC.md does not allow, and what it allows. */
void virtual_explain(const ta_config *config, const ta_hal *hal);

bool virtual_open(virtual_amplifier *v, const virtual_options *options);
bool virtual_close(virtual_amplifier *v);
void virtual_run(virtual_amplifier *v, uint64_t tick);

/* Hands a CAN frame to the amplifier; false where it is remote or longer than frames can be. */
bool virtual_feed_frame(virtual_amplifier *v, uint32_t id, bool fd, const uint8_t *data,
                        size_t size);

/* Writes to the file of what is sent, if there is one. */
void virtual_record(virtual_amplifier *v, uint8_t kind, const uint8_t *bytes, size_t size);

/* Runs records from a file to its end; false where one is cut off or too long. */
bool virtual_replay(virtual_amplifier *v, FILE *records);

/* Serve until a signal comes; false where the link cannot be opened. */
bool virtual_serve_pty(virtual_amplifier *v);
bool virtual_serve_can(virtual_amplifier *v, const char *path);
bool virtual_serve_socketcan(virtual_amplifier *v, const char *interface);

/* What they share: runs the amplifier in real time until a signal comes. `receive` takes what waits on
 * the file descriptor; while that is -1 it is called each round, and may open it. */
void virtual_serve(virtual_amplifier *v, uint8_t link, int *fd,
                   void (*receive)(virtual_amplifier *v));

#endif
