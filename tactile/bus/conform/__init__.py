"""The behavior vectors of the protocol, run against an amplifier on its own link."""
