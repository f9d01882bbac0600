"""The stub vehicles as a server: sockets, the clock and a separate process.

It may import all of sitl.
"""
