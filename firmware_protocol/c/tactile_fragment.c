/* Cutting and reassembly; see the header. Each rule of section 3.2 that drops a transfer is one
 * `drop` below. */
#include "tactile_fragment.h"

size_t ta_cut(ta_cutter *cutter, uint8_t *out, size_t room)
{
    size_t at = 1;
    if (cutter->started && cutter->sent == cutter->size) {
        return 0;
    }
    out[0] = (uint8_t)(cutter->id & TA_FRAGMENT_ID);
    if (!cutter->started) {
        out[0] = (uint8_t)(out[0] | TA_FRAGMENT_START);
        tp_put_le(out + 1, cutter->size, 2);
        at = 3;
    }
    size_t part = cutter->size - cutter->sent;
    if (part > room - at) {
        part = room - at;
    }
    memcpy(out + at, cutter->packet + cutter->sent, part);
    out[0] = (uint8_t)(out[0] | cutter->toggle);
    cutter->sent += part;
    cutter->started = true;
    cutter->toggle ^= TA_FRAGMENT_TOGGLE;
    if (cutter->sent == cutter->size) {
        out[0] = (uint8_t)(out[0] | TA_FRAGMENT_END);
    }
    return at + part;
}

size_t ta_can_fd_length(size_t size)
{
    static const uint8_t lengths[] = {12, 16, 20, 24, 32, 48};
    if (size <= 8u) {
        return size;
    }
    for (size_t i = 0; i < sizeof lengths; i++) {
        if (size <= lengths[i]) {
            return lengths[i];
        }
    }
    return 64u;
}

void ta_reassembly_init(ta_reassembly *r, size_t limit, uint32_t tick_hz, uint32_t *dropped)
{
    r->tick_hz = tick_hz;
    r->limit = limit;
    r->dropped = dropped;
    r->number = 0;
    for (size_t i = 0; i < TA_TRANSFERS; i++) {
        r->transfers[i].used = false;
    }
}

static void drop(ta_reassembly *r, ta_transfer *transfer)
{
    transfer->used = false;
    ++*r->dropped;
}

void ta_reassembly_expire(ta_reassembly *r, uint64_t now)
{
    for (size_t i = 0; i < TA_TRANSFERS; i++) {
        ta_transfer *t = &r->transfers[i];
        if (t->used && ta_elapsed(now, t->start, TP_FRAGMENT_TIMEOUT_MS, r->tick_hz)) {
            drop(r, t);
        }
    }
}

static ta_transfer *find(ta_reassembly *r, uint32_t identifier, uint8_t id)
{
    for (size_t i = 0; i < TA_TRANSFERS; i++) {
        ta_transfer *t = &r->transfers[i];
        if (t->used && t->identifier == identifier && t->id == id) {
            return t;
        }
    }
    return NULL;
}

/* A free place, or that of the oldest transfer, which is dropped. */
static ta_transfer *place(ta_reassembly *r)
{
    ta_transfer *oldest = &r->transfers[0];
    for (size_t i = 0; i < TA_TRANSFERS; i++) {
        ta_transfer *t = &r->transfers[i];
        if (!t->used) {
            return t;
        }
        if (ta_distance(t->number, oldest->number) < 0) {
            oldest = t;
        }
    }
    drop(r, oldest);
    return oldest;
}

/* Whether a fragment can be one at all: not empty, and a start has toggle 0 and a whole length. */
static bool well_formed(const uint8_t *fragment, size_t size)
{
    if (size == 0) {
        return false;
    }
    return (fragment[0] & TA_FRAGMENT_START) == 0 ||
           ((fragment[0] & TA_FRAGMENT_TOGGLE) == 0 && size >= 3u);
}

/* A start: NULL, and counted, where its length is out of range. */
static ta_transfer *begin(ta_reassembly *r, uint32_t identifier, const uint8_t *fragment,
                          size_t size, uint64_t now)
{
    size_t length = (size_t)tp_get_le(fragment, size, 1, 2);
    if (length < TA_OVERHEAD || length > r->limit) {
        ++*r->dropped;
        return NULL;
    }
    ta_transfer *t = place(r);
    t->used = true;
    t->identifier = identifier;
    t->id = fragment[0] & TA_FRAGMENT_ID;
    t->toggle = 0;
    t->number = r->number++;
    t->start = now;
    t->length = length;
    t->size = 0;
    return t;
}

/* Adds what a fragment carries; false where it is out of turn or too much. */
static bool add(ta_transfer *t, uint8_t first, const uint8_t *bytes, size_t size, bool padded)
{
    bool end = (first & TA_FRAGMENT_END) != 0;
    size_t missing = t->length - t->size;
    if ((first & TA_FRAGMENT_TOGGLE) != t->toggle) {
        return false;
    }
    if (size > missing) {
        if (!end || !padded) {
            return false;
        }
        size = missing;
    }
    if (size > 0) {
        memcpy(t->bytes + t->size, bytes, size);
    }
    t->size += size;
    t->toggle ^= TA_FRAGMENT_TOGGLE;
    return !end || t->size == t->length;
}

const ta_transfer *ta_reassembly_feed(ta_reassembly *r, uint32_t identifier,
                                      const uint8_t *fragment, size_t size, bool padded,
                                      uint64_t now)
{
    ta_reassembly_expire(r, now);
    if (!well_formed(fragment, size)) {
        ++*r->dropped;
        return NULL;
    }
    bool start = (fragment[0] & TA_FRAGMENT_START) != 0;
    size_t head = start ? 3u : 1u;
    ta_transfer *t = find(r, identifier, fragment[0] & TA_FRAGMENT_ID);
    if (start) {
        if (t != NULL) {
            drop(r, t);
        }
        t = begin(r, identifier, fragment, size, now);
    } else if (t == NULL) {
        ++*r->dropped;
    }
    if (t == NULL) {
        return NULL;
    }
    if (!add(t, fragment[0], fragment + head, size - head, padded)) {
        drop(r, t);
        return NULL;
    }
    if ((fragment[0] & TA_FRAGMENT_END) == 0) {
        return NULL;
    }
    t->used = false;
    return t;
}
