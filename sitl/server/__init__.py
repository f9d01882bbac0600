"""The stub vehicles as a server: sockets, the clock and a process of their own.

It may import all of sitl.
"""
