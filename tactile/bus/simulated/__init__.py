"""Amplifiers in memory, and links to them that take their time and fail on request."""
