"""Session of the protocol with all amplifiers on one wire, of whichever kind the wire is.

`session` decides what to send and when, `peer` holds what is known of one amplifier, `stream` keeps
the positions that all amplifiers put out together, and `link_bus` runs the session in a thread.
"""
