"""Flights: the agents of a team run over MAVLink and Zenoh or in a simulation, watched by a supervisor process.

It may import viewer, flightlog, console, preflight and link.
"""
