"""Sweeps: simulated flights over values and seeds, drawn or combined, their journal, their table and their figure.

It may import flight, flightlog, console, metrics and mission; only the command line and `cordon` import it.
"""
