/* Guards; see the header. */
#include "tactile_guard.h"

#define POLE_BITS 14u
#define OLDER 2u /* instants by which the current that is judged is older than the latest */
#define FALL_HZ 1000u
#define RISE_HZ 20u

static int32_t per_instant(uint32_t rate, uint32_t hertz)
{
    int32_t instants = (int32_t)(rate / hertz > 0 ? rate / hertz : 1u);
    return (TA_GAIN_FULL - (int32_t)TP_GUARD_LEAST + instants - 1) / instants;
}

void ta_guard_start(ta_guard *g, uint8_t channels, uint32_t rate)
{
    memset(g, 0, sizeof *g);
    g->channels = channels;
    g->left = TP_GUARD_BLOCK;
    g->fall = per_instant(rate, FALL_HZ);
    g->rise = per_instant(rate, RISE_HZ);
}

static uint32_t get(const uint8_t *entry, size_t at, size_t size)
{
    return (uint32_t)tp_get_le(entry, TA_GUARD_ENTRY, at, size);
}

bool ta_guard_valid(const uint8_t *entry)
{
    return entry[1] <= TA_GUARD_SHIFT_MOST && entry[2] <= TA_GUARD_SHIFT_MOST;
}

void ta_guard_decode(ta_guard_entry *e, const uint8_t *entry)
{
    e->armed = (entry[0] & TP_GUARD_FLAG_ARMED) != 0;
    e->releases = (entry[0] & TP_GUARD_FLAG_RELEASE) != 0;
    e->drive_shift = entry[1];
    e->change_shift = entry[2];
    e->limit = (uint16_t)get(entry, 4, 2);
    e->share = (uint16_t)get(entry, 6, 2);
    e->floor = get(entry, 8, 4);
    for (size_t i = 0; i < 2; i++) {
        e->poles[i] = (int16_t)get(entry, 12 + 2 * i, 2);
    }
    for (size_t i = 0; i < TP_GUARD_TAPS; i++) {
        e->drive[i] = (int16_t)get(entry, 16 + 2 * i, 2);
        e->change[i] = (int16_t)get(entry, 16 + 2 * (TP_GUARD_TAPS + i), 2);
    }
}

void ta_guard_take(ta_guard *g, size_t channel, const ta_guard_entry *entry)
{
    g->guards[channel].pending = *entry;
    g->guards[channel].waits = true;
}

static int32_t moved(const ta_guard *g, size_t channel, int32_t gain)
{
    if (g->guards[channel].reason != TP_GUARD_REASON_NONE) {
        int32_t lower = gain - g->fall;
        return lower > (int32_t)TP_GUARD_LEAST ? lower : (int32_t)TP_GUARD_LEAST;
    }
    int32_t higher = gain + g->rise;
    return higher < TA_GAIN_FULL ? higher : TA_GAIN_FULL;
}

bool ta_guard_move(ta_guard *g, int32_t *gains)
{
    if (!g->moves) {
        return false;
    }
    g->moves = false;
    /*@ loop invariant 0 <= i <= g->channels;
        loop invariant \forall integer c; 0 <= c < g->channels ==> 0 <= gains[c] <= TA_GAIN_FULL;
        loop assigns i, g->moves, gains[0 .. g->channels - 1];
        loop variant g->channels - i; */
    for (size_t i = 0; i < g->channels; i++) {
        gains[i] = moved(g, i, gains[i]);
        g->moves = g->moves || gains[i] < TA_GAIN_FULL;
    }
    return g->moves;
}

static bool watches(const ta_guarded *u)
{
    return u->entry.armed && u->reason == TP_GUARD_REASON_NONE;
}

/* A block begins, at a place of the ring, with an entry that has come during the last one. Returns whether that
 * releases the channel. */
static bool begin(ta_guarded *u, size_t block)
{
    uint8_t before = u->reason;
    if (u->waits) {
        if (!watches(u)) {
            u->complete = 0;
            u->doubted = false;
        }
        u->reason = u->pending.releases ? TP_GUARD_REASON_NONE : u->reason;
        u->entry = u->pending;
        u->waits = false;
    }
    u->residual = 0;
    u->squares = 0;
    u->blocks[block].product = 0;
    u->blocks[block].change = 0;
    return u->reason != before;
}

static int32_t code_of(int64_t value)
{
    return (int32_t)(value > INT16_MAX ? INT16_MAX : value < -INT16_MAX ? -INT16_MAX : value);
}

/* Adds an instant to a block; `code` is that of the current, with the older ones before it. */
static void accumulate(ta_guarded *u, ta_guard_sums *sums, const int16_t *code)
{
    const ta_guard_entry *e = &u->entry;
    const int16_t *drive = e->drive;
    const int16_t *taken = e->change;
    const int16_t *end = drive + TP_GUARD_TAPS;
    int64_t expected = 0;
    int64_t change = 0;
    do {
        int32_t step = code[0] - code[-1];
        expected += (int64_t)step * *drive++;
        change += (int64_t)step * *taken++;
        code--;
    } while (drive < end);
    int32_t current = u->currents[OLDER - 1u];
    int64_t now = (int64_t)current * (1 << POLE_BITS);
    now += (int32_t)u->currents[OLDER] * e->poles[0];
    now += (int32_t)u->currents[OLDER + 1u] * e->poles[1];
    int32_t residual = code_of(ta_rounded(now, POLE_BITS) - ta_rounded(expected, e->drive_shift));
    int32_t gone = code_of(ta_rounded(change, e->change_shift));
    u->residual += residual * residual;
    u->squares += current * current;
    sums->product += residual * gone;
    sums->change += gone * gone;
}

/* The decision at the end of a block, section 17.3. */
static uint8_t judge(ta_guarded *u)
{
    const ta_guard_entry *e = &u->entry;
    ta_guard_sums all = {0, 0};
    for (size_t i = 0; i < TP_GUARD_BLOCKS; i++) {
        all.product += u->blocks[i].product;
        all.change += u->blocks[i].change;
    }
    u->complete = (uint8_t)(u->complete < TP_GUARD_BLOCKS ? u->complete + 1u : TP_GUARD_BLOCKS);
    int64_t allowed = (int64_t)TP_GUARD_BLOCK * e->limit * e->limit;
    allowed += ta_shift_right(e->share * u->squares, 16);
    bool lost = u->complete >= TP_GUARD_BLOCKS && 5 * all.product > 3 * all.change &&
                all.product > (int64_t)e->floor;
    bool sure = lost && u->doubted;
    u->doubted = lost;
    if (u->residual > allowed) {
        return TP_GUARD_REASON_RESIDUAL;
    }
    return sure ? TP_GUARD_REASON_LOST : TP_GUARD_REASON_NONE;
}

static void remember(ta_guarded *u, int16_t current)
{
    for (size_t i = TA_GUARD_PAST - 1u; i > 0; i--) {
        u->currents[i] = u->currents[i - 1u];
    }
    u->currents[0] = current == INT16_MIN ? -INT16_MAX : current;
}

void ta_guard_skip(ta_guard *g)
{
    for (size_t i = 0; i < g->channels; i++) {
        remember(&g->guards[i], 0);
    }
}

bool ta_guard_add(ta_guard *g, const ta_correlator *c, const int16_t *currents)
{
    bool over = g->left == 1;
    size_t next = g->block + 1u < TP_GUARD_BLOCKS ? g->block + 1u : 0;
    bool changed = false;
    for (size_t i = 0; i < g->channels; i++) {
        ta_guarded *u = &g->guards[i];
        if (watches(u)) {
            accumulate(u, &u->blocks[g->block], ta_correlator_code(c, i));
            u->reason = over ? judge(u) : u->reason;
            changed = changed || u->reason != TP_GUARD_REASON_NONE;
        } else if (over) {
            u->complete = 0;
        }
        remember(u, currents[i]);
        if (over && begin(u, next)) {
            changed = true;
        }
    }
    g->block = (uint8_t)(over ? next : g->block);
    g->left = (uint8_t)(over ? TP_GUARD_BLOCK : g->left - 1u);
    g->moves = g->moves || changed;
    return changed;
}
