"""The data of a flight from its logs, as arrays for charts and tables.

It may import the readers of logs, metrics and mission, no chart and no page.
"""
