/* Reports: what the amplifier has to tell its host unasked. The instants note them, with what held then, and
 * ta_serve sends them, so that no instant waits for a link. */
#ifndef TACTILE_REPORTS_H
#define TACTILE_REPORTS_H

#include "tactile_core.h"

#define TA_REPORTS 16u /* reports that wait; an instant notes ten at most */

typedef enum {
    TA_REPORT_PULSE,
    TA_REPORT_LOG,
    TA_REPORT_SENSE,
    TA_REPORT_CORRELATION,
    TA_REPORT_GUARDED,
    TA_REPORT_MARKED
} ta_report_kind;

typedef struct {
    uint8_t kind;
    uint8_t level;    /* of LOG, whose text is `text` or that of the fault with the number `fault` */
    uint8_t fault;
    const char *text;
    union {
        tp_pulse pulse;
        struct {
            uint32_t position; /* first one with other gains */
            ta_set residual; /* channels that have tripped, by the reason */
            ta_set lost;
        } guarded;
        tp_marked marked;
    } of;
} ta_report;

typedef struct {
    ta_report waiting[TA_REPORTS];
    uint8_t head;
    uint8_t count;
} ta_reports;

#endif
