"""Perceptual strength: how strong a texture is on a display, and the gain that its limits allow."""
