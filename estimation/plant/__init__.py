"""The identified plant: its model, its provenance, and its validation in flight.

It may import state and settings.
"""
