"""The replay of a recorded flight: decisions recomputed and compared, and the timeline of one vehicle.

It may import flightlog, console and mission, and agents' cores.
"""
