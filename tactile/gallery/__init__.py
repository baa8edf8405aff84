"""Textures as something to look at: their surface, their spectrum, and a stroke on a display.

`views` has the arrays, `terminal_view` draws them where there is only text; `tactile.plots` draws
them to files.
"""
