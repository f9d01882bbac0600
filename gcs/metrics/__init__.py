"""The metrics of a flight: its record, its errors, its verdicts and the log of its events.

It may import mission.
"""
