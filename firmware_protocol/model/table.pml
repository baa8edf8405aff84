/* Times, messages, states, codes of NAK and the table of states of section 6, written by
 * generate.py from schema.toml. A cell is STAYS, REFUSED | code of NAK, or
 * state | next << 3, where next is the state that follows RAMPDOWN. */
#define STAYS 64
#define REFUSED 128
#define WATCHDOG_MS 150
#define FADE_MS 20
#define INPUT_CLOSED_MS 50
#define M_HELLO 1
#define M_TIME 2
#define M_SYNC 3
#define M_START 4
#define M_STOP 5
#define M_ARM 6
#define M_DISARM 7
#define M_ESTOP 8
#define M_CLEAR_FAULT 9
#define M_HEARTBEAT 10
#define M_LIMITS 11
#define M_GET 12
#define M_SET 13
#define M_IDENTIFY 14
#define M_POLL 15
#define M_PCM 16
#define M_CARRIERS 17
#define M_SPECTRUM 18
#define M_GUARD 19
#define M_MARK 20
#define IDLE 0
#define ARMED 1
#define RUNNING 2
#define RAMPDOWN 3
#define SAFE 4
#define FAULT 5
#define ESTOP 6
#define NAK_UNKNOWN_TYPE 1
#define NAK_VERSION 2
#define NAK_UNSUPPORTED 3
#define NAK_LENGTH 4
#define NAK_SESSION 5
#define NAK_BUSY 6
#define NAK_STATE 7
#define NAK_NOT_ARMED 8
#define NAK_FAULT 9
#define NAK_ESTOP 10
#define NAK_RANGE 11
#define NAK_CHANNEL 12
#define NAK_FORMAT 13
#define NAK_PARAMETER 14
#define NAK_READ_ONLY 15
#define NAK_TIME 16
#define NAK_CARRIERS 17
#define NAK_INPUT_OPEN 18

#define TABLE_HELLO_OTHER ( \
    state == IDLE -> STAYS : ( \
    state == ARMED -> REFUSED | NAK_BUSY : ( \
    state == RUNNING -> REFUSED | NAK_BUSY : ( \
    state == RAMPDOWN -> REFUSED | NAK_BUSY : ( \
    state == SAFE -> STAYS : ( \
    state == FAULT -> STAYS : ( \
    STAYS)))))))

#define TABLE_ARM ( \
    state == IDLE -> ARMED : ( \
    state == ARMED -> ARMED : ( \
    state == RUNNING -> REFUSED | NAK_STATE : ( \
    state == RAMPDOWN -> REFUSED | NAK_STATE : ( \
    state == SAFE -> ARMED : ( \
    state == FAULT -> REFUSED | NAK_FAULT : ( \
    REFUSED | NAK_ESTOP)))))))

#define TABLE_START ( \
    state == IDLE -> REFUSED | NAK_NOT_ARMED : ( \
    state == ARMED -> RUNNING : ( \
    state == RUNNING -> REFUSED | NAK_STATE : ( \
    state == RAMPDOWN -> REFUSED | NAK_STATE : ( \
    state == SAFE -> REFUSED | NAK_NOT_ARMED : ( \
    state == FAULT -> REFUSED | NAK_FAULT : ( \
    REFUSED | NAK_ESTOP)))))))

#define TABLE_STOP ( \
    state == IDLE -> STAYS : ( \
    state == ARMED -> STAYS : ( \
    state == RUNNING -> RAMPDOWN | ARMED << 3 : ( \
    state == RAMPDOWN -> STAYS : ( \
    state == SAFE -> STAYS : ( \
    state == FAULT -> STAYS : ( \
    STAYS)))))))

#define TABLE_DISARM ( \
    state == IDLE -> STAYS : ( \
    state == ARMED -> IDLE : ( \
    state == RUNNING -> RAMPDOWN | IDLE << 3 : ( \
    state == RAMPDOWN -> RAMPDOWN | IDLE << 3 : ( \
    state == SAFE -> IDLE : ( \
    state == FAULT -> STAYS : ( \
    STAYS)))))))

#define TABLE_ESTOP ( \
    state == IDLE -> ESTOP : ( \
    state == ARMED -> ESTOP : ( \
    state == RUNNING -> ESTOP : ( \
    state == RAMPDOWN -> ESTOP : ( \
    state == SAFE -> ESTOP : ( \
    state == FAULT -> ESTOP : ( \
    STAYS)))))))

#define TABLE_CLEAR_FAULT ( \
    state == IDLE -> STAYS : ( \
    state == ARMED -> STAYS : ( \
    state == RUNNING -> STAYS : ( \
    state == RAMPDOWN -> STAYS : ( \
    state == SAFE -> STAYS : ( \
    state == FAULT -> IDLE : ( \
    IDLE)))))))

#define TABLE_LIMITS ( \
    state == IDLE -> STAYS : ( \
    state == ARMED -> STAYS : ( \
    state == RUNNING -> REFUSED | NAK_STATE : ( \
    state == RAMPDOWN -> REFUSED | NAK_STATE : ( \
    state == SAFE -> STAYS : ( \
    state == FAULT -> STAYS : ( \
    STAYS)))))))

#define TABLE_CARRIERS ( \
    state == IDLE -> STAYS : ( \
    state == ARMED -> STAYS : ( \
    state == RUNNING -> REFUSED | NAK_STATE : ( \
    state == RAMPDOWN -> REFUSED | NAK_STATE : ( \
    state == SAFE -> STAYS : ( \
    state == FAULT -> STAYS : ( \
    STAYS)))))))

#define TABLE_WATCHDOG ( \
    state == IDLE -> STAYS : ( \
    state == ARMED -> SAFE : ( \
    state == RUNNING -> RAMPDOWN | SAFE << 3 : ( \
    state == RAMPDOWN -> RAMPDOWN | SAFE << 3 : ( \
    state == SAFE -> STAYS : ( \
    state == FAULT -> STAYS : ( \
    STAYS)))))))

#define TABLE_FAULT ( \
    state == IDLE -> FAULT : ( \
    state == ARMED -> FAULT : ( \
    state == RUNNING -> FAULT : ( \
    state == RAMPDOWN -> FAULT : ( \
    state == SAFE -> FAULT : ( \
    state == FAULT -> STAYS : ( \
    STAYS)))))))

#define TABLE_ESTOP_INPUT ( \
    state == IDLE -> ESTOP : ( \
    state == ARMED -> ESTOP : ( \
    state == RUNNING -> ESTOP : ( \
    state == RAMPDOWN -> ESTOP : ( \
    state == SAFE -> ESTOP : ( \
    state == FAULT -> ESTOP : ( \
    STAYS)))))))
