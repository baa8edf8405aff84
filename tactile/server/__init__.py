"""Server: clients over WebSocket and OSC, and the displays that they share.

`server` opens the sockets, `connection` reads the messages of one client, `host` manages all
displays, and `client` carries out what one client asks of them. A process of `tactile.playback`
plays each display.
"""
