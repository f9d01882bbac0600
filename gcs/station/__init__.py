"""The operator's page: its pictures of a team or of a recorded flight, and its server.

It may import viewer, flightlog, console, preflight, keys and mission.
"""
