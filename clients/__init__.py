"""Clients in other languages, and what generates their messages and builds them."""
