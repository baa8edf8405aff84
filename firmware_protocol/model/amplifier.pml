/* Sessions and safety of one amplifier, two hosts, a third party and a lossy link (SPEC.md, sections
 * 5 to 8 and 14), for the model checker SPIN. README.md says what is abstracted, and why that is sound.
 *
 * -DSTEP_MS=10 makes time finer, -DBREAK=n breaks the model (README.md), -DSTRICT adds a property
 * that SPEC.md does not promise, and -DPROMPT makes simulations comparable with an amplifier.
 */
#include "table.pml"

#ifndef STEP_MS
#define STEP_MS 50
#endif
#ifndef BREAK
#define BREAK 0
#endif
#ifndef ONLY
#define ONLY 0
#endif
#define HOLDS(property, what) assert((ONLY != 0 && ONLY != property) || (what))

/* Properties, by the section or duty of SPEC.md */

#define ARMED_ONLY 1     /* duty 2: it plays nothing unless its owner has armed it */
#define NO_RISE 2        /* duty 4: after an ESTOP the output does not rise before CLEAR_FAULT */
#define CLEAR_ONLY 3     /* duty 5: ESTOP and FAULT end by CLEAR_FAULT only */
#define KNOWN_TRIPS 4    /* 5: CLEAR_FAULT ends nothing that its sender did not know of */
#define SETTLED_ONLY 5   /* 5: nor while the output falls, the input is open or the fault goes on */
#define NO_TAKEOVER 6    /* duty 7: no takeover while the owner lives or an output is not at 0 V */
#define DEAD_MAN 7       /* duty 3: at 0 V within 150 + 20 ms of the owner's last HEARTBEAT or ARM */
#define QUICK 8          /* duty 4: at 0 V within 20 ms of an ESTOP */
#define VOLTAGE 9        /* 6: the high voltage is on in ARMED, RUNNING, RAMPDOWN, or while not at 0 V */
#define AT_ZERO 10       /* 6: the output is at 0 V in IDLE, ARMED and SAFE */
#define REPEATED 11      /* 6: a START that is repeated changes nothing and is acknowledged */
#define OPEN_STOPS 12    /* 6.3: an amplifier whose input is open is in ESTOP */
#define OPEN_REFUSES 13  /* 6.3: ARM is refused while the input is open */
#define PLAYS_AGAIN 14   /* a host that nobody disturbs any more plays */
#define SENT_SINCE 15    /* not promised, -DSTRICT: no ARM from before an ESTOP counts after it */

#ifdef PROMPT
#define d_step atomic /* the simulator of SPIN 6.5 interrupts a d_step that is inside atomic */
#define IS_PROMPT true
#else
#define IS_PROMPT false
#endif

#define STEPS(ms) ((ms + STEP_MS - 1) / STEP_MS)
#define WATCHDOG STEPS(WATCHDOG_MS)
#define FADE STEPS(FADE_MS)
#define SETTLED STEPS(INPUT_CLOSED_MS)
#define NEVER (WATCHDOG + FADE + 1)  /* steps after which the time since an event no longer counts */
#define CALM_MOST (WATCHDOG + 2 * FADE + SETTLED + 4)  /* steps in which the host has to play again */

#define POWERED (state == ARMED || state == RUNNING || state == RAMPDOWN)
#define LATCHED (state == FAULT || state == ESTOP)
#define INPUT_OPEN (contact_open || settling > 0)

/* The amplifier */

#define ZERO 0
#define NONZERO 1
#define FALLING 2

byte state = IDLE, then = IDLE; /* `then` follows RAMPDOWN; IDLE in other states */
byte session, output = ZERO;
byte age = WATCHDOG;  /* steps since HEARTBEAT or ARM of the session, up to WATCHDOG */
byte fall;            /* steps since the output began to fall */
byte settling;        /* steps until a closed contact counts as closed */
byte position;        /* session << 1 | bit of the START in effect */
bool high_voltage, watched, contact_open, fault_now;

/* The hosts: 1 and 3 are tokens of the well-behaved host, which draws another one after its death,
 * and 2 is that of its rival. */

#define RIVAL 2
#define TOKEN (1 + 2 * reborn)

#define OUT 0      /* no session: HELLO */
#define TAKEN 1    /* ARM */
#define STARTING 2 /* START */
#define PLAYING 3
#define HALTING 4  /* STOP, to arm again */
#define ENDING 5   /* DISARM */
#define STOPPED 6  /* in ESTOP or FAULT: POLL */
#define CLEARING 7 /* a person has cleared: CLEAR_FAULT */

#define DONE 128   /* any answer but NAK */

byte stage = OUT;
bool reborn, start_bit, waiting, beat_due;
/* What each host knows of the trips: `fresh` if the counter has not moved since the host read it,
 * `knows` if nothing has stopped the amplifier since then. Only a fault of the model parts them. */
bool fresh, knows, rival_fresh, rival_knows;

/* The link: a packet of the well-behaved host is delivered at once, lost, or delayed, and a delayed one
 * may be a copy. One that is delayed is overtaken by any number of others. */

#define KIND(packet) (packet & 15)
#define OF_REBORN 16
#define BIT 32
#define FRESH 64
#define KNOWS 128

byte delayed;      /* 0 for none */

/* From here on only the well-behaved host sends, and the link delivers at once. */
bool calm;
byte calm_steps;   /* steps of calm in which the host did not play */

/* What the properties need to remember */

byte armed_by;         /* session whose ARM switched the high voltage on */
byte unheard = NEVER;  /* steps since HEARTBEAT or ARM of the owner itself */
byte stopping;         /* steps since an ESTOP, an opening or a fault, while the output falls */
bool stopped;          /* an ESTOP, an opening or a fault came, and no CLEAR_FAULT that knew of it */

/* Scratch of atomic sequences: the packet under way, and the amplifier before it */

hidden byte m_kind, m_token, m_bit, m_code, m_fresh, m_knows, sent, answered, cell, before;

#ifdef PROMPT
#define TRACE(event, token, bits) \
    printf("T %d %d %d %d %d %d %d\n", event, token, bits, state, session, high_voltage, m_code)
bool at_rest;          /* the output has come to 0 V in this step: nothing else happens in it */
byte patience;         /* steps without a trouble, up to 6 */
#define MAY_ACT (!at_rest && !WATCHDOG_DUE)
#define MAY_UPSET (patience > 5)
#define UPSET patience = 0
#else
#define TRACE(event, token, bits) skip
#define MAY_ACT true
#define MAY_UPSET true
#define UPSET skip
#endif
/* Events that are no messages, beyond all ids of these. */
#define T_STEP 200
#define T_INPUT 201
#define T_FAULT 202
#define T_WATCHDOG 203
#define T_REST 204

/* States, section 6 */

inline enter(next) {
    state = next;
    then = IDLE;
    if
    :: state != RUNNING && output == NONZERO -> output = FALLING; fall = 0
    :: else
    fi;
    if
    :: POWERED -> high_voltage = true
    :: !POWERED && (output == ZERO || BREAK == 5) -> high_voltage = false
    :: else
    fi
}

inline follow(entry) {
    cell = entry;
    if
    :: cell & (STAYS | REFUSED)
    :: !(cell & (STAYS | REFUSED)) && (cell & 7) == RAMPDOWN ->
        if
        :: state != RAMPDOWN || BREAK == 6 -> fall = 0
        :: else
        fi;
        if
        :: output == NONZERO -> output = FALLING
        :: else
        fi;
        state = RAMPDOWN;
        then = cell >> 3
    :: else -> enter(cell & 7)
    fi
}

/* Count an ESTOP, an opening or a fault, which no host knows of yet. */
inline trip(counted) {
    knows = false; rival_knows = false;
    delayed = delayed & (255 - KNOWS);
    if
    :: counted ->
        fresh = false; rival_fresh = false;
        delayed = delayed & (255 - FRESH)
    :: else
    fi;
    stopped = true
}

/* Requests, section 5 */

inline refuse_by(entry) {
    cell = entry;
    m_code = (cell & REFUSED -> cell & 127 : DONE)
}

inline hear() {
    age = 0;
    watched = watched || !(BREAK == 17 && m_kind == M_ARM);
    if
    :: m_token == session -> unheard = 0
    :: else
    fi
}

#define IS_HELD ((age < WATCHDOG && BREAK != 3) || (output != ZERO && BREAK != 4) || \
    (BREAK == 19 && session != 0))

inline take_hello() {
    if
    :: m_token == session
    :: else ->
        refuse_by(TABLE_HELLO_OTHER);
        if
        :: m_code == DONE && IS_HELD -> m_code = NAK_BUSY
        :: m_code == DONE && !IS_HELD ->
            HOLDS(NO_TAKEOVER, unheard >= WATCHDOG && output == ZERO && !POWERED);
            session = m_token; age = WATCHDOG; unheard = NEVER
        :: else
        fi
    fi
}

inline take_arm() {
    refuse_by(TABLE_ARM);
    if
    :: m_code == DONE ->
#ifdef STRICT
        HOLDS(SENT_SINCE, m_knows);
#endif
        hear();
        follow(TABLE_ARM);
        armed_by = m_token;
        HOLDS(OPEN_REFUSES, !INPUT_OPEN)
    :: else
    fi
}

inline take_start() {
    if
    :: state == RUNNING && position == (m_token << 1 | m_bit) && BREAK != 7
    :: else ->
        refuse_by(TABLE_START);
        if
        :: m_code == DONE -> follow(TABLE_START);
            position = m_token << 1 | m_bit
        :: else
        fi
    fi
}

inline take_clear_fault() {
    if
    :: LATCHED && !m_fresh && BREAK != 2 -> m_code = NAK_STATE
    :: LATCHED && (m_fresh || BREAK == 2) && output != ZERO && BREAK != 8 -> m_code = NAK_STATE
    :: LATCHED && (m_fresh || BREAK == 2) && (output == ZERO || BREAK == 8) &&
            INPUT_OPEN && BREAK != 9 -> m_code = NAK_INPUT_OPEN
    :: LATCHED && (m_fresh || BREAK == 2) && (output == ZERO || BREAK == 8) &&
            (!INPUT_OPEN || BREAK == 9) && fault_now && BREAK != 18 -> m_code = NAK_FAULT
    :: else ->
        follow(TABLE_CLEAR_FAULT);
        if
        :: before != state ->
            HOLDS(KNOWN_TRIPS, m_knows);
            HOLDS(SETTLED_ONLY, output == ZERO && !INPUT_OPEN && !fault_now);
            stopped = false
        :: else
        fi
    fi
}

/* Lower limits would make a fall that is under way slower. */
inline take_limits() {
    refuse_by(TABLE_LIMITS);
    if
    :: m_code == DONE && output != ZERO && BREAK != 10 -> m_code = NAK_STATE
    :: m_code == DONE && output != ZERO && BREAK == 10 -> fall = 0
    :: else
    fi
}

inline act() {
    if
    :: m_kind == M_HELLO -> take_hello()
    :: m_kind == M_ARM -> take_arm()
    :: m_kind == M_START -> take_start()
    :: m_kind == M_STOP -> follow(TABLE_STOP)
    :: m_kind == M_DISARM -> follow(TABLE_DISARM)
    :: m_kind == M_CLEAR_FAULT -> take_clear_fault()
    :: m_kind == M_LIMITS -> take_limits()
    :: m_kind == M_HEARTBEAT -> hear()
    :: m_kind == M_ESTOP ->
        trip(!(BREAK == 11 && state == ESTOP));
        if
        :: BREAK == 12 && state == RUNNING -> follow(TABLE_STOP)
        :: else -> follow(TABLE_ESTOP)
        fi;
        if
        :: BREAK == 21 -> fall = 0
        :: else
        fi
    :: else /* POLL */
    fi
}

/* What holds after each event. */
inline judge(kind) {
    /* an ESTOP ends a FAULT, by outdoing it */
    HOLDS(CLEAR_ONLY, !(before == ESTOP && state != ESTOP) || kind == M_CLEAR_FAULT);
    HOLDS(CLEAR_ONLY,
        !(before == FAULT && state != FAULT && state != ESTOP) || kind == M_CLEAR_FAULT);
    HOLDS(CLEAR_ONLY, !stopped || LATCHED);
    HOLDS(AT_ZERO, output == ZERO || state == RUNNING || state == RAMPDOWN || LATCHED);
    HOLDS(VOLTAGE, high_voltage == (POWERED || output != ZERO));
    HOLDS(OPEN_STOPS, !INPUT_OPEN || state == ESTOP);
    HOLDS(REPEATED, !(kind == M_START && before == RUNNING) ||
        (state == RUNNING && (m_code == DONE) == (position == (m_token << 1 | m_bit))));
    if
    :: !POWERED -> armed_by = 0; watched = false
    :: else
    fi;
    if
    :: state != RUNNING -> position = 0
    :: else
    fi;
    if
    :: !POWERED && output == ZERO && unheard >= WATCHDOG -> unheard = NEVER
    :: else
    fi;
    if
    :: output == ZERO || !LATCHED -> stopping = 0
    :: else
    fi;
    if
    :: output == ZERO && state != RAMPDOWN -> fall = 0
    :: else
    fi
}

inline receive() {
    before = state;
    m_code = DONE;
    if
    :: m_kind != M_HELLO && m_kind != M_POLL && m_kind != M_ESTOP && m_token != session &&
            !(BREAK == 1 && m_kind == M_HEARTBEAT && session != 0) -> m_code = NAK_SESSION
    :: else -> act()
    fi;
    TRACE(m_kind, m_token, m_bit | m_fresh << 1);
    judge(m_kind)
}

/* Instants, section 7.1: watchdog, and the end of a fall. Where one is due time does not go on, but
 * packets may come before it, since it is due within a sample. */

#define WATCHDOG_DUE (watched && POWERED && age >= WATCHDOG && BREAK != 13)
#define FALLS (state == RAMPDOWN || output == FALLING)
#define IS_DUE (WATCHDOG_DUE || (FALLS && fall >= FADE))

inline rise() {
    HOLDS(ARMED_ONLY, armed_by != 0 && armed_by == session);
    HOLDS(NO_RISE, !stopped);
    output = (state == RUNNING -> NONZERO : FALLING)
}

active proctype amplifier() {
    do
    :: atomic { WATCHDOG_DUE -> d_step {
            before = state; m_code = 0; watched = false; follow(TABLE_WATCHDOG);
            TRACE(T_WATCHDOG, 0, 0);
            judge(0) } }
    :: atomic { FALLS && (!IS_PROMPT || !WATCHDOG_DUE) -> d_step {
            before = state;
            output = ZERO;
            if
            :: state == RAMPDOWN -> cell = then; enter(cell)
            :: else -> high_voltage = (POWERED || BREAK == 14)
            fi;
#ifdef PROMPT
            at_rest = true;
            m_code = 0;
#endif
            TRACE(T_REST, 0, 0);
            judge(0) } }
    /* a signal passes zero, begins, starves or ends */
    :: atomic { output == NONZERO && !calm && !IS_PROMPT -> output = ZERO }
    :: atomic { output == FALLING && state == RAMPDOWN && !calm && !IS_PROMPT -> output = ZERO }
    :: atomic { output == ZERO && !IS_PROMPT && (state == RUNNING ||
            (state == RAMPDOWN && !calm) || (BREAK == 20 && LATCHED)) -> d_step { rise() } }
    od
}

/* The well-behaved host */

#define REQUEST ( \
    stage == OUT -> M_HELLO : ( \
    stage == TAKEN -> M_ARM : ( \
    stage == STARTING -> M_START : ( \
    stage == HALTING -> M_STOP : ( \
    stage == ENDING -> M_DISARM : ( \
    stage == STOPPED -> M_POLL : \
    M_CLEAR_FAULT))))))
#define SEES_END (stage == PLAYING && (state != RUNNING || session != TOKEN))
#define BEATS (stage == STARTING || stage == PLAYING)

/* Each packet is marked with what its sender knows when it sends it. */
inline write(packet, kind) {
    packet = kind | (reborn -> OF_REBORN : 0);
    if
    :: kind == M_START && start_bit -> packet = packet | BIT
    :: kind == M_CLEAR_FAULT -> packet = packet | (fresh -> FRESH : 0) | (knows -> KNOWS : 0)
#ifdef STRICT
    :: kind == M_ARM -> packet = packet | KNOWS
#endif
    :: else
    fi
}

inline take_answer() {
    waiting = calm && m_code != DONE && BREAK != 22; /* until the next step, where it repeats */
    if
    :: m_code == NAK_SESSION -> stage = OUT
    :: (stage == TAKEN || stage == STARTING) && (m_code == NAK_ESTOP || m_code == NAK_FAULT) ->
        stage = STOPPED
    :: (stage == TAKEN || stage == STARTING) && m_code == NAK_STATE -> stage = HALTING
    :: stage == STARTING && m_code == NAK_NOT_ARMED -> stage = TAKEN
    :: stage == STARTING && m_code == DONE -> stage = PLAYING
    :: stage == TAKEN && m_code == DONE -> stage = STARTING; start_bit = !start_bit
    :: (stage == OUT || stage == HALTING || stage == ENDING) && m_code == DONE -> stage = TAKEN
    :: stage == STOPPED -> stage = CLEARING; fresh = true; knows = true
    :: stage == CLEARING -> stage = (m_code == DONE -> TAKEN : STOPPED)
    :: else
    fi
}

/* The amplifier takes the packet `sent`, and the host the answer to what it has asked, unless that is
 * lost. */
inline deliver() {
    m_kind = KIND(sent);
    m_token = (sent & OF_REBORN -> 3 : 1);
    m_bit = (sent & BIT) != 0;
    m_fresh = (sent & FRESH) != 0;
    m_knows = (sent & KNOWS) != 0;
    receive();
    if
    :: answered && m_token == TOKEN && stage != PLAYING && m_kind == REQUEST -> take_answer()
    :: else
    fi
}

#define ASKS (stage != PLAYING && !waiting)
#define HAS_BEAT (BEATS && (!calm || beat_due))

active proctype host() {
    do
    :: atomic { (ASKS || HAS_BEAT) && MAY_ACT ->
            if
            :: ASKS -> write(sent, REQUEST)
            :: HAS_BEAT -> beat_due = false; write(sent, M_HEARTBEAT)
            fi;
            if
            :: answered = true
            :: !calm -> answered = false
            fi;
            d_step { deliver() } }
    :: atomic { ASKS && !calm && !delayed -> d_step { write(delayed, REQUEST) } }
    :: atomic { BEATS && !calm && !delayed -> d_step { write(delayed, M_HEARTBEAT) } }
    /* it learns from PULSE or STATUS that the amplifier does not play any more */
    :: atomic { SEES_END -> stage = (session != TOKEN -> OUT : (LATCHED -> STOPPED : TAKEN)) }
    :: atomic { !calm && BEATS && MAY_UPSET -> stage = HALTING; UPSET }
    :: atomic { !calm && stage != OUT && stage != ENDING && MAY_UPSET -> stage = ENDING; UPSET }
    /* it dies, and comes back with a token of which nothing is on its way any more */
    :: atomic { !calm && stage != OUT && MAY_UPSET &&
            (!delayed || ((delayed & OF_REBORN) != 0) == reborn) -> d_step {
            UPSET; stage = OUT; reborn = !reborn; fresh = false; knows = false } }
    od
}

active proctype link() {
    do
    :: atomic { delayed && MAY_ACT ->
            sent = delayed;
            if
            :: answered = true
            :: answered = false
            fi;
            if
            :: delayed = 0
            :: true /* one of several copies */
            fi;
            d_step { deliver() } }
    :: atomic { delayed -> delayed = 0 }
    od
}

/* The rival and the third party send anything at any time; what the link may do to it is more of the
 * same (README.md). */

active proctype rival() {
    do
    :: atomic { !calm && MAY_ACT ->
            m_bit = 0;
            if
            :: m_kind = M_HELLO
            :: m_kind = M_HEARTBEAT
            :: MAY_UPSET -> m_kind = M_ESTOP; UPSET
            :: session == RIVAL -> m_kind = M_ARM
            :: session == RIVAL -> m_kind = M_START
            :: session == RIVAL -> m_kind = M_START; m_bit = 1
            :: session == RIVAL -> m_kind = M_STOP
            :: session == RIVAL -> m_kind = M_DISARM
            :: session == RIVAL -> m_kind = M_LIMITS
            :: session == RIVAL -> m_kind = M_CLEAR_FAULT
            :: m_kind = M_POLL; rival_fresh = true; rival_knows = true
            fi;
            d_step {
                m_token = RIVAL; m_fresh = rival_fresh;
                m_knows = rival_knows || m_kind != M_CLEAR_FAULT;
                receive()
            } }
    od
}

/* The world: contact, hardware, time */

inline move_contact() {
    before = state;
    m_code = 0;
    contact_open = !contact_open;
    if
    :: contact_open -> settling = 0; trip(BREAK != 15); follow(TABLE_ESTOP_INPUT)
    :: else -> settling = SETTLED
    fi;
    TRACE(T_INPUT, contact_open, 0);
    judge(0)
}

inline change_fault() {
    before = state;
    m_code = 0;
    fault_now = !fault_now;
    if
    :: fault_now -> trip(BREAK != 16); follow(TABLE_FAULT)
    :: else
    fi;
    TRACE(T_FAULT, fault_now, 0);
    judge(0)
}

active proctype world() {
    do
    :: atomic { (contact_open || (!calm && MAY_UPSET)) && MAY_ACT -> d_step {
            UPSET; move_contact() } }
    :: atomic { (fault_now || (!calm && MAY_UPSET)) && MAY_ACT -> d_step {
            UPSET; change_fault() } }
    :: atomic { !calm && !IS_PROMPT -> d_step { calm = true; delayed = 0 } }
    od
}

#define PLAYS (stage == PLAYING && state == RUNNING && session == TOKEN && output == NONZERO)
#define RESTS (!HAS_BEAT && !ASKS && !SEES_END && !contact_open && !fault_now && \
    !(state == RUNNING && output == ZERO))

inline older(steps, most) {
    if
    :: steps < most -> steps++
    :: else
    fi
}

inline step() {
    older(age, WATCHDOG);
    older(unheard, NEVER);
    if
    :: FALLS -> fall++
    :: else
    fi;
    if
    :: output != ZERO && LATCHED -> stopping++
    :: else
    fi;
    if
    :: settling > 0 -> settling--
    :: else
    fi;
    if
    :: calm && !PLAYS -> calm_steps++
    :: else
    fi;
    waiting = false;
    beat_due = calm && BEATS;
    HOLDS(DEAD_MAN, unheard <= WATCHDOG + FADE || output == ZERO);
    HOLDS(QUICK, stopping <= FADE || output == ZERO);
    HOLDS(PLAYS_AGAIN, calm_steps <= CALM_MOST)
}

active proctype clock() {
    do
    :: atomic { !IS_DUE && !(IS_PROMPT && FALLS) && (!calm || RESTS) -> d_step {
            step();
#ifdef PROMPT
            at_rest = false;
            older(patience, 6);
            m_code = 0;
            if
            :: state == RUNNING && output == ZERO -> rise()
            :: else
            fi;
#endif
            TRACE(T_STEP, 0, 0) } }
    od
}

#ifdef LIVENESS
/* Without a bound, and also where no time passes: from the calm on the host always plays again. */
ltl plays_again { [] (calm -> <> PLAYS) }
#endif
