"""The mission: the file that a user writes, its validation, and what follows from it for each vehicle.

It may import agents, sitl.world and estimation.
"""
