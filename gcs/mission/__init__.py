"""The mission: the file that a user writes, its validation, and each vehicle's configuration derived from it.

It may import agents, sitl.world and estimation.
"""
