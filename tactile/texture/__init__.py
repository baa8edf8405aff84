"""Textures: the descriptor that a file holds, and the surface that it is realized as."""
