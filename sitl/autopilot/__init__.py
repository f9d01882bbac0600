"""The stub's autopilots, each in a file of its name: modes, guidance, parameters and dialect, without MAVLink's bytes.

It may import vehicle.
"""
