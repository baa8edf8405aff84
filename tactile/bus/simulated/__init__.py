"""Amplifiers in memory, and links to them that take time and fail on request."""
