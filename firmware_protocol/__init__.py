"""The protocol between a host and a tactile amplifier; SPEC.md is normative.

Bytes in, messages out, no I/O: whoever holds the link feeds what it received and sends what it is
given. It knows no physics and no bus.

- `messages` : what is said (written by `generate` from schema.toml)
- `packet` : header and CRC-32
- `serial_link`, `can_link`, `i2c_link` : how packets are delimited
- `samples`, `spectrum` : how drive is packed
- `host`, `clock` : the host's side
- `amplifier`, `player` : an amplifier in Python; `c/` holds one in C99
"""
