"""Profiles: the numbers that describe one kind of vehicle, bundled or from a file, and where they come from.

It may import plant and settings.
"""
