"""Frames, the identified plant and the Kalman filters: pure functions and small objects."""
