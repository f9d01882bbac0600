"""The operator's terminal: the live table, keys, the view of a running team, and commands sent to it.

It may import metrics and mission.
"""
