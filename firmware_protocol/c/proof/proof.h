/* What the drivers share: arbitrary values. EVA takes each of them as any value of its range. */
#ifndef PROOF_H
#define PROOF_H

#include <__fc_builtin.h>

#include "../tactile_core.h"

/* Nothing is known of it but that it is initialized. */
#define ANY(object) Frama_C_make_unknown((char *)&(object), sizeof (object))

#endif
