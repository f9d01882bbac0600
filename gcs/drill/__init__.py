"""Drills: faults injected into a flight on stub vehicles, and the measured reactions judged.

It may import flight, identify, report and what is below them; only the command line imports it.
"""
