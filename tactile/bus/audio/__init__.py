"""Amplifiers behind an audio card, which a process of its own feeds."""
