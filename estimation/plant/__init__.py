"""The identified plant: its model, where its numbers come from, and whether it still explains the vehicle.

It may import state and settings.
"""
