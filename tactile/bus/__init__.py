"""Buses: what carries drive blocks to an amplifier. Every driver keeps the contract of `base`."""
