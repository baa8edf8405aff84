"""Rendering of a texture under a moving finger: from contact to a limited drive voltage."""
