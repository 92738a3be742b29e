"""The protocol between host and board: messages, framing, link, segment arithmetic, clock synchronisation.

Sans-IO: nothing here opens a port, reads a clock or needs an event loop. Both ends use the same classes.
"""
