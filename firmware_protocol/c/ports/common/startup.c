/* From reset to main, and faults of the processor (duty 9). */
#include "port.h"

#include <string.h>

extern uint32_t data_load, data_begin, data_end, bss_begin, bss_end, stack_top;

int main(void);
void reset(void);

/* The watchdog resets the part, as nothing feeds it here. */
static void fault(void)
{
    __asm__ volatile("cpsid i");
    board_outputs_off();
    for (;;) {
    }
}

void reset(void)
{
    board_outputs_off();
    memcpy(&data_begin, &data_load, (size_t)((char *)&data_end - (char *)&data_begin));
    memset(&bss_begin, 0, (size_t)((char *)&bss_end - (char *)&bss_begin));
    main();
    fault();
}

/* The stack, then the handlers of reset, of faults and of the system. */
static const struct {
    uint32_t *stack;
    port_handler handlers[15];
} vectors __attribute__((section(".vectors.system"), used)) = {
    &stack_top,
    {reset, fault, fault, fault, fault, fault, NULL, NULL, NULL, NULL, fault, fault, NULL, fault, fault},
};
