/* Guards against a contactor that leaves the finger (17): the difference between each current and the one
 * that the host expects under the finger, and the decision that turns a channel down.
 *
 * An instant costs 2 x TP_GUARD_TAPS + 6 products per armed channel, and about 350 bytes of memory. Every
 * TP_GUARD_BLOCK instants a decision takes some 20 sums and products more.
 */
#ifndef TACTILE_GUARD_H
#define TACTILE_GUARD_H

#include "tactile_correlator.h"

#define TA_GUARD_ENTRY 68u    /* bytes of a channel in GUARD */
#define TA_GUARD_SHIFT_MOST 31u
#define TA_GUARD_PAST 4u      /* earlier currents that a residual takes */

/* Sums of a block, or of several, that tell a lost contact. */
typedef struct {
    int64_t product; /* of residual times the change that a lost contact would make */
    int64_t change;  /* of squares of that change */
} ta_guard_sums;

typedef struct {
    bool armed;
    bool releases;
    uint8_t drive_shift;
    uint8_t change_shift;
    uint16_t limit;
    uint16_t share;
    uint32_t floor;
    int16_t poles[2];
    int16_t drive[TP_GUARD_TAPS];
    int16_t change[TP_GUARD_TAPS];
} ta_guard_entry;

typedef struct {
    ta_guard_entry entry;   /* in force */
    ta_guard_entry pending; /* in force when the block is over, if it `waits` */
    bool waits;
    bool doubted;     /* the contact seemed lost at the end of the last block */
    uint8_t reason;   /* for which it has tripped, as in GUARDED */
    uint8_t complete; /* blocks since it was armed, at most TP_GUARD_BLOCKS */
    int16_t currents[TA_GUARD_PAST]; /* that were known before, the latest first */
    int64_t residual; /* sums over the block under way, of squares of the residual */
    int64_t squares;  /* and of the current */
    ta_guard_sums blocks[TP_GUARD_BLOCKS]; /* ring; that of the block under way is at `block` */
} ta_guarded;

typedef struct {
    uint8_t channels;
    uint8_t left;  /* instants until the block is over */
    uint8_t block; /* place of the block under way */
    bool moves;   /* a gain is below TA_GAIN_FULL, or will be at the next instant */
    int32_t fall; /* of a gain per instant */
    int32_t rise;
    ta_guarded guards[TA_CHANNELS];
} ta_guard;

/* Forgets all entries, as at START. */
void ta_guard_start(ta_guard *g, uint8_t channels, uint32_t rate);

/* Returns whether the shifts of an entry of TA_GUARD_ENTRY bytes are possible. */
bool ta_guard_valid(const uint8_t *entry);

/* Decodes a valid entry. */
void ta_guard_decode(ta_guard_entry *e, const uint8_t *entry);

/* Keeps an entry until the block under way is over. */
void ta_guard_take(ta_guard *g, size_t channel, const ta_guard_entry *entry);

/* Moves the gains of all channels on, by an instant of RUNNING. Returns whether one is below TA_GAIN_FULL. */
bool ta_guard_move(ta_guard *g, int32_t *gains);

/* Adds the current codes that are known now, of the code that the correlator says; returns whether a
 * channel has tripped or was released. */
bool ta_guard_add(ta_guard *g, const ta_correlator *c, const int16_t *currents);

/* Goes on by an instant that was skipped: the codes stayed, so that no current flowed. */
void ta_guard_skip(ta_guard *g);

#endif
