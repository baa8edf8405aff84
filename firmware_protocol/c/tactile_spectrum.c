/* Spectrum frames; see the header. */
#include "tactile_spectrum.h"

/* SINE[k] = round(32767 sin(2 pi k / 1024)) of the first quarter, k = 0 ... 256. */
static const int16_t quarter[257] = {
        0,   201,   402,   603,   804,  1005,  1206,  1407,  1608,  1809,  2009,  2210,
     2410,  2611,  2811,  3012,  3212,  3412,  3612,  3811,  4011,  4210,  4410,  4609,
     4808,  5007,  5205,  5404,  5602,  5800,  5998,  6195,  6393,  6590,  6786,  6983,
     7179,  7375,  7571,  7767,  7962,  8157,  8351,  8545,  8739,  8933,  9126,  9319,
     9512,  9704,  9896, 10087, 10278, 10469, 10659, 10849, 11039, 11228, 11417, 11605,
    11793, 11980, 12167, 12353, 12539, 12725, 12910, 13094, 13279, 13462, 13645, 13828,
    14010, 14191, 14372, 14553, 14732, 14912, 15090, 15269, 15446, 15623, 15800, 15976,
    16151, 16325, 16499, 16673, 16846, 17018, 17189, 17360, 17530, 17700, 17869, 18037,
    18204, 18371, 18537, 18703, 18868, 19032, 19195, 19357, 19519, 19680, 19841, 20000,
    20159, 20317, 20475, 20631, 20787, 20942, 21096, 21250, 21403, 21554, 21705, 21856,
    22005, 22154, 22301, 22448, 22594, 22739, 22884, 23027, 23170, 23311, 23452, 23592,
    23731, 23870, 24007, 24143, 24279, 24413, 24547, 24680, 24811, 24942, 25072, 25201,
    25329, 25456, 25582, 25708, 25832, 25955, 26077, 26198, 26319, 26438, 26556, 26674,
    26790, 26905, 27019, 27133, 27245, 27356, 27466, 27575, 27683, 27790, 27896, 28001,
    28105, 28208, 28310, 28411, 28510, 28609, 28706, 28803, 28898, 28992, 29085, 29177,
    29268, 29358, 29447, 29534, 29621, 29706, 29791, 29874, 29956, 30037, 30117, 30195,
    30273, 30349, 30424, 30498, 30571, 30643, 30714, 30783, 30852, 30919, 30985, 31050,
    31113, 31176, 31237, 31297, 31356, 31414, 31470, 31526, 31580, 31633, 31685, 31736,
    31785, 31833, 31880, 31926, 31971, 32014, 32057, 32098, 32137, 32176, 32213, 32250,
    32285, 32318, 32351, 32382, 32412, 32441, 32469, 32495, 32521, 32545, 32567, 32589,
    32609, 32628, 32646, 32663, 32678, 32692, 32705, 32717, 32728, 32737, 32745, 32752,
    32757, 32761, 32765, 32766, 32767,
};

/* round(32767 x 256 x 10^(-(255 - c) / 80)), but 0 for c = 0. */
static const int32_t amplitudes[256] = {
          0,    5606,    5770,    5938,    6112,    6290,    6474,    6663,    6858,
       7058,    7264,    7476,    7694,    7919,    8150,    8388,    8633,    8885,
       9145,    9412,    9687,    9970,   10261,   10560,   10869,   11186,   11513,
      11849,   12195,   12551,   12917,   13295,   13683,   14082,   14494,   14917,
      15352,   15801,   16262,   16737,   17226,   17729,   18246,   18779,   19328,
      19892,   20473,   21071,   21686,   22319,   22971,   23642,   24332,   25042,
      25774,   26526,   27301,   28098,   28919,   29763,   30632,   31527,   32447,
      33395,   34370,   35373,   36406,   37469,   38564,   39690,   40849,   42041,
      43269,   44532,   45833,   47171,   48549,   49966,   51425,   52927,   54472,
      56063,   57700,   59385,   61119,   62904,   64741,   66631,   68577,   70579,
      72640,   74761,   76944,   79191,   81504,   83884,   86333,   88854,   91449,
      94119,   96867,   99696,  102607,  105603,  108687,  111860,  115127,  118489,
     121949,  125510,  129174,  132946,  136829,  140824,  144936,  149168,  153524,
     158007,  162621,  167370,  172257,  177287,  182464,  187792,  193275,  198919,
     204728,  210706,  216859,  223191,  229708,  236416,  243319,  250424,  257737,
     265263,  273009,  280981,  289186,  297630,  306321,  315266,  324472,  333946,
     343698,  353734,  364063,  374694,  385635,  396896,  408486,  420413,  432690,
     445325,  458328,  471712,  485486,  499662,  514253,  529269,  544724,  560630,
     577001,  593850,  611191,  629038,  647406,  666310,  685767,  705792,  726401,
     747613,  769443,  791911,  815036,  838835,  863330,  888539,  914485,  941189,
     968672,  996958, 1026069, 1056031, 1086868, 1118605, 1151269, 1184886, 1219486,
    1255095, 1291745, 1329464, 1368285, 1408240, 1449361, 1491683, 1535241, 1580071,
    1626210, 1673696, 1722569, 1772869, 1824638, 1877918, 1932754, 1989192, 2047277,
    2107059, 2168586, 2231910, 2297083, 2364159, 2433193, 2504244, 2577369, 2652630,
    2730088, 2809808, 2891856, 2976300, 3063209, 3152656, 3244716, 3339463, 3436977,
    3537339, 3640631, 3746939, 3856352, 3968959, 4084855, 4204135, 4326898, 4453246,
    4583283, 4717117, 4854859, 4996624, 5142528, 5292692, 5447242, 5606304, 5770011,
    5938498, 6111906, 6290377, 6474059, 6663105, 6857671, 7057919, 7264014, 7476127,
    7694433, 7919115, 8150357, 8388352,
};

/* SINE between a and b, of which r / 2^16 has passed; the shift is arithmetic. */
static int32_t between(int32_t a, int32_t b, int32_t r)
{
    int32_t rise = (b - a) * r + (1 << 15);
    return a + (rise >= 0 ? rise >> 16 : ~(~rise >> 16));
}

/* Cosine and sine of k steps: the first quarter, read upward and downward, with the signs of the quadrant. */
static ta_phasor steps_on(uint32_t k)
{
    int32_t up = quarter[k & 255u];
    int32_t down = quarter[256u - (k & 255u)];
    ta_phasor first = {down, up};
    ta_phasor second = {-up, down};
    ta_phasor p = (k & 256u) != 0 ? second : first;
    if ((k & 512u) != 0) {
        p.i = -p.i;
        p.q = -p.q;
    }
    return p;
}

/* The same between two steps; rounding is not symmetric, so that the sign comes before it. */
ta_phasor ta_turn(uint32_t angle)
{
    const int16_t *up = quarter + (angle >> 22 & 255u);
    const int16_t *down = quarter + 256u - (angle >> 22 & 255u);
    int32_t r = (int32_t)(angle >> 6 & 0xFFFFu);
    int32_t sine[2] = {up[0], up[1]};
    int32_t cosine[2] = {down[0], down[-1]};
    if ((angle & 1u << 30) != 0) {
        sine[0] = down[0];
        sine[1] = down[-1];
        cosine[0] = -up[0];
        cosine[1] = -up[1];
    }
    if ((angle & 1u << 31) != 0) {
        sine[0] = -sine[0];
        sine[1] = -sine[1];
        cosine[0] = -cosine[0];
        cosine[1] = -cosine[1];
    }
    ta_phasor p;
    p.i = between(cosine[0], cosine[1], r);
    p.q = -between(sine[0], sine[1], r);
    return p;
}

int32_t ta_amplitude(uint8_t code)
{
    return amplitudes[code];
}

/* A phase code is a whole number of steps of SINE, so that nothing is interpolated. */
ta_phasor ta_phasor_decode(uint8_t amplitude, uint8_t phase)
{
    int64_t a = amplitudes[amplitude];
    ta_phasor turn = steps_on(4u * phase);
    ta_phasor p;
    p.i = (int32_t)ta_rounded(a * turn.i, 15);
    p.q = (int32_t)ta_rounded(a * turn.q, 15);
    return p;
}

void ta_envelope_clear(ta_envelope *e)
{
    ta_envelope_silence(e);
    e->ramping = false;
    e->queued = 0;
    e->in_force = 0;
    for (size_t i = 0; i <= TA_QUEUE; i++) {
        e->order[i] = (uint8_t)i;
    }
}

void ta_envelope_silence(ta_envelope *e)
{
    memset(e->present, 0, sizeof e->present);
}

/* The frame at a place of `order`, of which 0 is that of the ramp and 1 the first of the queue. */
static ta_frame *frame_at(ta_envelope *e, size_t place)
{
    return &e->frames[e->order[place]];
}

static uint32_t position_at(const ta_envelope *e, size_t place)
{
    return e->frames[e->order[place]].position;
}

/* Puts the frame at a place of `order` behind the queue, which gets shorter by one. */
static void retire(ta_envelope *e, size_t place)
{
    uint8_t *order = e->order + place;
    const uint8_t *last = e->order + e->queued;
    uint8_t frame = *order;
    for (; order < last; order++) {
        *order = order[1];
    }
    *order = frame;
    e->queued--;
}

/* Puts the last free frame, which is behind the queue and behind the other free ones, at a place of `order`. */
static void insert(ta_envelope *e, size_t place)
{
    uint8_t frame = e->order[TA_QUEUE];
    for (size_t i = TA_QUEUE; i > place; i--) {
        e->order[i] = e->order[i - 1u];
    }
    e->order[place] = frame;
    e->queued++;
}

static bool is_late(const ta_envelope *e, uint32_t position, uint32_t n)
{
    return ta_distance(position, n) <= 0 ||
           (e->ramping && ta_distance(position, position_at(e, 0)) <= 0);
}

/* The place in `order` of the first frame of the queue that is not before a position. */
static size_t place_for(const ta_envelope *e, uint32_t position)
{
    size_t at = 1;
    while (at <= e->queued && ta_distance(position, position_at(e, at)) > 0) {
        at++;
    }
    return at;
}

ta_frame_fate ta_envelope_offer(ta_envelope *e, uint32_t position, uint32_t n, uint32_t fifo,
                                ta_frame **frame)
{
    ta_frame_fate fate = TA_FRAME_KEPT;
    *frame = NULL;
    if (is_late(e, position, n)) {
        return TA_FRAME_LATE;
    }
    if (ta_distance(position, n) >= (int32_t)fifo) {
        return TA_FRAME_FUTURE;
    }
    size_t at = place_for(e, position);
    if (at <= e->queued && position_at(e, at) == position) {
        return TA_FRAME_KEPT;
    }
    if (e->queued == TA_QUEUE) {
        fate = TA_FRAME_FUTURE;
        if (at > TA_QUEUE) {
            return fate;
        }
        e->queued--;
    }
    *frame = frame_at(e, TA_QUEUE);
    (*frame)->position = position;
    return fate;
}

void ta_frame_decode(ta_frame *frame, uint16_t valid, const uint8_t *codes, uint8_t carriers)
{
    frame->valid = valid;
    for (size_t c = 0; c < carriers; c++) {
        frame->phasors[c] = ta_phasor_decode(codes[2u * c], codes[2u * c + 1u]);
    }
}

ta_frame_fate ta_envelope_keep(ta_envelope *e, const ta_frame *frame, uint32_t n)
{
    if (is_late(e, frame->position, n)) {
        return TA_FRAME_LATE;
    }
    insert(e, place_for(e, frame->position));
    return TA_FRAME_KEPT;
}

bool ta_envelope_ready(const ta_envelope *e, uint32_t n, bool moved)
{
    if (e->queued > 0) {
        return true;
    }
    if (!e->ramping) {
        return e->in_force > (moved ? 1u : 0u);
    }
    const ta_frame *target = &e->frames[e->order[0]];
    return target->position != n || target->valid > 0;
}

void ta_envelope_stop(ta_envelope *e, uint32_t n)
{
    e->ramping = false;
    e->in_force = 0;
    while (e->queued > 0 && ta_distance(position_at(e, 1), n) <= 0) {
        retire(e, 1);
    }
}

/* The sums over the carriers have at least one: without carriers there is no START (5). */

static int64_t add_product(int64_t sum, ta_phasor v, ta_phasor turn)
{
    sum += (int64_t)v.i * turn.i;
    sum += (int64_t)v.q * turn.q;
    return sum;
}

/* The value that a sum stands for, which is below 2^46: 64 carriers of products below 2^39, twice. */
static int16_t value_of(int64_t sum)
{
    int32_t value = (int32_t)ta_rounded(sum, 23);
    return (int16_t)ta_clamp(value, (int32_t)TP_FULL_SCALE_CODE);
}

int16_t ta_envelope_value(const ta_envelope *e, const ta_phasor *turns, uint8_t carriers)
{
    const ta_phasor *v = e->present;
    const ta_phasor *end = turns + carriers;
    int64_t sum = 0;
    do {
        sum = add_product(sum, *v++, *turns++);
    } while (turns < end);
    return value_of(sum);
}

/* The next two carry out a step and take the value in one pass: no instant costs much more than any other,
 * whatever frames begin or end at it. */

static int16_t step_on(ta_envelope *e, const ta_phasor *turns, uint8_t carriers)
{
    ta_phasor *present = e->present;
    const ta_phasor *step = e->step;
    const ta_phasor *end = turns + carriers;
    int64_t sum = 0;
    do {
        ta_phasor change = *step++;
        ta_phasor v = *present;
        ta_phasor turn = *turns++;
        v.i += change.i;
        v.q += change.q;
        *present++ = v;
        sum = add_product(sum, v, turn);
    } while (turns < end);
    return value_of(sum);
}

/* Begins a ramp of `length` positions at the envelope `from`. */
static int16_t begin_ramp(ta_envelope *e, const ta_phasor *from, int32_t length, const ta_phasor *turns,
                          uint8_t carriers)
{
    ta_phasor *present = e->present;
    ta_phasor *step = e->step;
    const ta_phasor *to = frame_at(e, 0)->phasors;
    const ta_phasor *end = turns + carriers;
    int64_t sum = 0;
    do {
        ta_phasor v = *from++;
        ta_phasor change = *to++;
        ta_phasor turn = *turns++;
        *present++ = v;
        change.i = (change.i - v.i) / length;
        change.q = (change.q - v.q) / length;
        *step++ = change;
        sum = add_product(sum, v, turn);
    } while (turns < end);
    return value_of(sum);
}

int16_t ta_envelope_next(ta_envelope *e, uint32_t n, bool moved, const ta_phasor *turns,
                         uint8_t carriers)
{
    const ta_phasor *from = e->present;
    if (moved && e->in_force > 0) {
        e->in_force--;
    }
    if (e->ramping && position_at(e, 0) == n) {
        from = frame_at(e, 0)->phasors;
        e->ramping = false;
        e->in_force = frame_at(e, 0)->valid;
    } else if (e->ramping) {
        return moved ? step_on(e, turns, carriers) : ta_envelope_value(e, turns, carriers);
    }
    if (e->queued > 0) {
        retire(e, 0);
        e->ramping = true;
        return begin_ramp(e, from, ta_distance(position_at(e, 0), n), turns, carriers);
    }
    if (from != e->present) {
        memcpy(e->present, from, carriers * sizeof *from);
    }
    return ta_envelope_value(e, turns, carriers);
}
