"""The flight log: recorder, file format, reader and recovery.

It may import preflight, mission and the types of agents that are recorded.
"""
