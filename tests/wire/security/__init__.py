"""Attacks on a flying team, and runs and computers that must not disturb it."""
