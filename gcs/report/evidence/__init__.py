"""What a log says about a flight, read once and held as arrays for charts and tables.

It may import the readers of logs, metrics and mission, no chart and no page.
"""
