"""The replay of a recorded flight: decisions computed again and compared, and the story of one vehicle.

It may import flightlog, console and mission, and agents' cores.
"""
