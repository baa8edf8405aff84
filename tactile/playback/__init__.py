"""Playback: the renderer and the bus of a display brought together.

`process` is the real-time program that plays one display for the server. Its `loop` renders each
block as late as possible, from the contacts in `shared_memory`, the `waves` of clients and the
`commands` of the server. `runs` plays one trajectory without a server, as ``tactile play`` does.
"""
