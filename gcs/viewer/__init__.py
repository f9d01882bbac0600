"""The 3-D scene of a flight for Foxglove viewers, live or in a log.

It may import flightlog, keys, style and mission.
"""
