"""Profiles: the parameters of one type of vehicle and their provenance, bundled or from a file.

It may import plant and settings.
"""
