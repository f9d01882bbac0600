"""From a plan to what is sent: the slew limit, the velocity feed-forward, the yaw and the altitude.

It may import control and safety.
"""
