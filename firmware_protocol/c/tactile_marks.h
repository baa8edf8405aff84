/* Marks of a stream (18): those that are kept until their position comes, and the code on the marker lines.
 *
 * An instant without marks costs two comparisons; one with n marks that are kept, up to n + 2.
 */
#ifndef TACTILE_MARKS_H
#define TACTILE_MARKS_H

#include "tactile_player.h"

typedef struct {
    uint32_t position; /* with whose sample it is shown */
    uint16_t samples;  /* instants for which it is shown, 1 at least */
    uint8_t code;
} ta_mark;

typedef struct {
    uint8_t count; /* marks that are kept, in any order */
    uint8_t lines; /* code that was put out last, 0 for none */
    uint16_t left; /* instants to come that show it as well */
    ta_mark kept[TP_MARKS_MOST];
} ta_marks;

/* Forgets the marks that are kept, as at START; the code that is shown stays for as long as it has to. */
static inline void ta_marks_forget(ta_marks *m)
{
    m->count = 0;
}

/* Keeps a mark for a stream, or drops it, which is not counted. */
void ta_marks_keep(ta_marks *m, const ta_player *p, const ta_mark *mark);

/* Returns whether an instant changes nothing: no mark is kept and none is shown. */
static inline bool ta_marks_rest(const ta_marks *m)
{
    return m->count == 0 && m->lines == 0;
}

/* Goes on by the instant of a position and settles `lines`. Its mark is taken, unless `hold` says that the position
 * stays, and shown if it `plays`. Returns whether a mark is shown from this instant on. */
bool ta_marks_instant(ta_marks *m, uint32_t position, bool hold, bool plays);

/* Goes on by an instant that was skipped: its mark is lost, and the lines stay as they are (7.1). */
void ta_marks_skip(ta_marks *m, uint32_t position, bool hold);

#endif
