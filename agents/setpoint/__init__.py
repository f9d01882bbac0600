"""From a plan to a setpoint: slew limit, velocity feed-forward, yaw and altitude.

It may import control and safety.
"""
