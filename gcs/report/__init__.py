"""The report of a flight: pages and tables, built from the evidence and the charts in the folders below.

It may import the pictures of station, the readers of logs, console, metrics and mission, not flight.
"""
