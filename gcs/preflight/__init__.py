"""Checks before take-off: findings with a grade and a reason, from the mission and from what each vehicle answers.

It may import link and mission.
"""
