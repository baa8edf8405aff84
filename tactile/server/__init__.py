"""The server: clients over WebSocket and OSC, and the displays that they share.

`server` opens the sockets, `connection` reads one client's messages, `host` knows all displays and
`client` what one client may do with them. A process of `tactile.playback` plays each display.
"""
