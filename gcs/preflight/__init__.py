"""Checks before take-off: findings with a grade and a reason, from the mission and from the vehicles' reports.

It may import link and mission.
"""
