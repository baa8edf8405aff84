/* Marks; see the header. */
#include "tactile_marks.h"

/* Returns the place of the mark for a position; `count` if there is none. */
static size_t find(const ta_marks *m, uint32_t position)
{
    size_t i = 0;
    while (i < m->count && m->kept[i].position != position) {
        i++;
    }
    return i;
}

void ta_marks_keep(ta_marks *m, const ta_player *p, const ta_mark *mark)
{
    int32_t ahead = ta_distance(mark->position, p->position);
    size_t place = find(m, mark->position);
    if (ahead >= 0 && ahead < p->fifo && place < TP_MARKS_MOST) {
        m->kept[place] = *mark;
        m->count = (uint8_t)(place < m->count ? m->count : m->count + 1u);
    }
}

/* Takes the mark for a position from those that are kept; returns whether there was one. */
static bool take(ta_marks *m, uint32_t position, ta_mark *mark)
{
    size_t place = find(m, position);
    if (place == m->count) {
        return false;
    }
    *mark = m->kept[place];
    m->kept[place] = m->kept[--m->count];
    return true;
}

static void count_down(ta_marks *m)
{
    m->left = (uint16_t)(m->left > 0 ? m->left - 1u : 0u);
}

bool ta_marks_instant(ta_marks *m, uint32_t position, bool hold, bool plays)
{
    ta_mark mark;
    m->lines = m->left > 0 ? m->lines : 0;
    count_down(m);
    if (hold || !take(m, position, &mark) || !plays) {
        return false;
    }
    m->lines = mark.code;
    m->left = (uint16_t)(mark.samples - 1u);
    return true;
}

void ta_marks_skip(ta_marks *m, uint32_t position, bool hold)
{
    ta_mark lost;
    count_down(m);
    if (!hold) {
        (void)take(m, position, &lost);
    }
}
