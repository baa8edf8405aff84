/* Second stage of boot (RP2040 data sheet, 2.8.1.3): lets the flash be read as memory, by the command 03h that any
 * flash has, and jumps to the program. The boot ROM runs it in RAM, wherever that is.
 *
 * 03h is slow: 64 bits of the SPI at 31 MHz for each word that is not in the cache of 16 kB. A board whose flash is
 * known reads it by four lines instead. The registers were checked against hardware/regs/ssi.h and
 * boot2_generic_03h.S of the pico-sdk. */
    .syntax unified
    .cpu cortex-m0plus
    .thumb

    .equ SSI, 0x18000000
    .equ SSI_CTRLR0, 0x00
    .equ SSI_CTRLR1, 0x04
    .equ SSI_SSIENR, 0x08
    .equ SSI_BAUDR, 0x14
    .equ SSI_SPI_CTRLR0, 0xF4
    .equ DIVIDER, 4                                 /* of the clock: even */
    .equ FRAME, 31 << 16 | 3 << 8                   /* 32 bits, which follow a command ("EEPROM read") */
    .equ COMMAND, 0x03 << 24 | 2 << 8 | 6 << 2      /* 03h, of 8 bits, and 24 bits of address, on one line */
    .equ VECTORS, 0x10000100
    .equ VTOR, 0xE000ED08

    .section .boot2, "ax"
    .thumb_func
boot2:
    ldr r0, =SSI
    movs r1, #0
    str r1, [r0, #SSI_SSIENR]
    movs r2, #DIVIDER
    str r2, [r0, #SSI_BAUDR]
    ldr r2, =FRAME
    str r2, [r0, #SSI_CTRLR0]
    str r1, [r0, #SSI_CTRLR1]                       /* one word each time */
    ldr r2, =COMMAND
    movs r3, #SSI_SPI_CTRLR0
    str r2, [r0, r3]
    movs r1, #1
    str r1, [r0, #SSI_SSIENR]
    ldr r0, =VECTORS
    ldr r1, =VTOR
    str r0, [r1]
    ldm r0!, {r1, r2}                               /* the stack, and the handler of reset */
    msr msp, r1
    bx r2
    .ltorg
    .balign 4
    .space 252 - (. - boot2)
