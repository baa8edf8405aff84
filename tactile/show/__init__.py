"""Visualization: a live picture in a terminal, still pictures of textures, and plots.

`live` draws the picture during playback. `views` computes the arrays of a still picture of a
texture, which `still` draws in a terminal and `plots` writes to files.
"""
