"""The protocol on a link: one session with all amplifiers of a wire, whichever kind it is.

`session` says what to send and when, `peer` is what it knows of one amplifier, `stream` keeps the
positions that all put out together, and `link_bus` runs the session in a thread.
"""
