"""Buses, which carry drive blocks to amplifiers; every driver keeps the contract of `base`."""
