"""Emergency stop, which shares no thread, process or socket with ordinary traffic.

A `latch` is a file that the server, the e-stop process and the playback process all map into
memory. The e-stop `process` listens for a `request` on a socket of its own and sets the latches.
"""
