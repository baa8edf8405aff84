"""Texture descriptors as they are stored in files, and the surfaces that they are realized as."""
