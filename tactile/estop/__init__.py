"""The emergency stop: it shares no thread, no process and no socket with ordinary traffic.

A `latch` is a file that server, e-stop process and playback process all map into memory. The
e-stop `process` listens for a `request` on a socket of its own and sets the latches.
"""
