/* An amplifier, and the host that feeds it, for the programs in this folder: 24 channels at
 * 8 kHz, and packets that tactile would send. */
#ifndef BENCH_H
#define BENCH_H

#include "../../tactile_amplifier.h"

#define RATE 8000u
#define TICK_HZ 25000000u
#define PERIOD (TICK_HZ / RATE)
#define BLOCK 16u      /* samples of a PCM packet, 2 ms */
#define HEARTBEAT 400u /* instants from heartbeat to heartbeat, 50 ms */
#define START_MS 10u   /* from START to the first sample */

typedef struct {
    const char *name;
    uint8_t format;
    uint32_t spacing; /* samples from packet to packet: BLOCK, or those from frame to frame */
    bool lossy;       /* some packets are not sent */
    bool guarded;     /* with currents, their correlations and guards */
} stream;

extern ta_amplifier amp;
extern uint64_t tick;     /* present tick of the host */
extern uint32_t position; /* at which the next stream begins */

/* Hands a packet of the host over to the amplifier; each program has its own. */
void handle(const uint8_t *packet, size_t size);

bool is_spectrum(const stream *s);

/* Position of the first packet of the next stream. A frame is of a position to come (10.3). */
uint32_t first_packet(const stream *s);

/* Powers up. */
bool power_up(const ta_hal *hal);

/* Arms and starts a stream. */
void begin(const stream *s);

/* Starts a stream again, from ARMED. */
void start(void);

void set(uint16_t parameter, uint32_t value);

/* Sends the guards of all channels. */
void guard(uint8_t entries[TA_CHANNELS][TA_GUARD_ENTRY]);

/* Writes the entry of a guard that is armed and allows everything. */
void allow_all(uint8_t entry[TA_GUARD_ENTRY]);

void heartbeat(void);
void poll_status(void);
void stop(void);
void clear_fault(uint32_t trips);

/* Sends the packet of a stream for a position. */
void send_packet(const stream *s, uint32_t at);

#endif
