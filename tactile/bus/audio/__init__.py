"""Amplifiers connected to an audio card, which a separate process feeds."""
