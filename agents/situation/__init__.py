"""The situation of one tick: the estimates, the centre of the ring, and the vehicle's frequency on it.

It may import team, tactics and settings.
"""
