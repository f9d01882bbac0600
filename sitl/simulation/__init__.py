"""The simulation of a team in simulated time, without sockets.

It may import vehicle and world.
"""
