/* What a board with the serial link keeps in RAM, for `make size`. */
#include "../../tactile_link.h"

ta_amplifier amplifier;
ta_serial serial;
