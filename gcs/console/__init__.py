"""The operator console: live table, keyboard, view of a running team, and commands to it.

It may import metrics and mission.
"""
