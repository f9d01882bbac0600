"""What 3-D viewers show of a flight, live or from a log.

It may import flightlog, style and mission.
"""
