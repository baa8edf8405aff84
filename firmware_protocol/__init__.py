"""Protocol between a host and a tactile amplifier; SPEC.md is normative.

The package turns bytes into messages and messages into bytes without any I/O: the owner of a link
passes in what it received and sends what it is given. The package depends neither on the physics
nor on a bus.

- `messages` : messages, codes and states (written by `generate` from schema.toml)
- `layout` : layout of their payloads
- `packet` : header and CRC-32
- `serial_link`, `can_link`, `i2c_link` : delimiting of packets on each link
- `samples`, `spectrum` : coding of the drive
- `host`, `clock` : host side; `capabilities` : what a host requires of CAPS
- `amplifier`, `player` : amplifier in Python; `c/` holds one in C99
"""
