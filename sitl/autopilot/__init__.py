"""The stub's autopilots, PX4 and ArduCopter: modes, guidance, fence and parameters, without MAVLink.

It may import vehicle.
"""
