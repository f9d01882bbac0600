"""The operator's page: what it shows of a team or of a recorded flight, and the server that it comes from.

It may import viewer, flightlog, console, preflight, keys and mission.
"""
