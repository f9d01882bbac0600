"""Sweeps: simulated flights over the product of values and seeds, their journal, their table and their figure.

It may import flight, flightlog, console, metrics and mission; only the command line imports it.
"""
