/* Largest counts of instructions, and of bytes, on a Cortex-M4 and on a Cortex-M0+: 24 channels at 8 kHz, a buffer
 * of 512 samples, packets of 1024 bytes, gcc -Os. A change that needs more does not pass. An instant of 8 kHz is
 * 21000 cycles at 168 MHz; an instruction takes 1.2 to 1.5 cycles on either core. */
#ifndef BUDGETS_H
#define BUDGETS_H

#define BUDGETS(BUDGET)                                                                            \
    BUDGET("idle_mean", 900, 1400)                                                                 \
    BUDGET("idle_worst", 900, 1400)                                                                \
    BUDGET("skipped_mean", 130, 160)                                                               \
    BUDGET("pcm16_mean", 1500, 2200)                                                               \
    BUDGET("pcm16_worst", 1700, 2800)                                                              \
    BUDGET("pcm16_packet_mean", 18000, 30000)                                                      \
    BUDGET("pcm16_packet_worst", 20000, 32000)                                                     \
    BUDGET("pcm16_per_second", 20000000, 32000000)                                                 \
    BUDGET("pcm12_mean", 1500, 2200)                                                               \
    BUDGET("pcm12_worst", 2000, 3200)                                                              \
    BUDGET("pcm12_packet_mean", 20000, 28000)                                                      \
    BUDGET("pcm12_packet_worst", 21000, 30000)                                                     \
    BUDGET("pcm12_per_second", 20000000, 32000000)                                                 \
    BUDGET("bfp8_mean", 1500, 2200)                                                                \
    BUDGET("bfp8_worst", 2000, 3200)                                                               \
    BUDGET("bfp8_packet_mean", 16000, 22000)                                                       \
    BUDGET("bfp8_packet_worst", 17000, 24000)                                                      \
    BUDGET("bfp8_per_second", 18000000, 28000000)                                                  \
    BUDGET("lossy_mean", 1500, 3000)                                                               \
    BUDGET("lossy_worst", 4200, 8500)                                                              \
    BUDGET("spectrum_mean", 9000, 56000)                                                           \
    BUDGET("spectrum_worst", 12000, 140000)                                                        \
    BUDGET("spectrum_packet_mean", 35500, 86000)                                                   \
    BUDGET("spectrum_packet_worst", 36000, 88000)                                                  \
    BUDGET("spectrum_per_second", 74000000, 450000000)                                             \
    BUDGET("guarded_mean", 13000, 60000)                                                           \
    BUDGET("guarded_worst", 16000, 70000)                                                          \
    BUDGET("masked_worst", 3000, 4500)                                                             \
    BUDGET("stack", 1200, 1200)                                                                    \
    BUDGET("ta_amplifier", 43000, 43000)                                                           \
    BUDGET("ta_serial", 1100, 1100)

#endif
