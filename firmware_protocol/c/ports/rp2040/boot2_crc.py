"""Print the CRC-32 of the second stage of boot of the RP2040 as assembly."""

import pathlib
import sys

POLYNOMIAL = 0x04C11DB7
SIZE = 252


def checksum(stage: bytes) -> int:
    """Compute the CRC-32 that the boot ROM expects (RP2040 data sheet, 2.8.1.3.1).

    The most significant bit comes first; it begins with all ones, and is not inverted.

    Parameters
    ----------
    stage : bytes
        Second stage of the boot, padded with zeros to 252 bytes.

    Returns
    -------
    int
        Checksum, which follows the stage as a little-endian word.
    """
    crc = 0xFFFFFFFF
    for byte in stage:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ (POLYNOMIAL if crc & 1 << 31 else 0)) & 0xFFFFFFFF
    return crc


if __name__ == "__main__":
    stage = pathlib.Path(sys.argv[1]).read_bytes()
    if len(stage) != SIZE:
        sys.exit(f"the second stage has {len(stage)} bytes, not {SIZE}")
    print(f'    .section .boot2.crc, "a"\n    .4byte {checksum(stage):#010x}')
