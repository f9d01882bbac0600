"""The identified plant: its model, its file, where its numbers come from, and whether it still explains the vehicle.

It may import state and settings.
"""
