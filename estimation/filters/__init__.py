"""The Kalman filters of the own vehicle and of the target, and their consistency tests.

It may import plant.
"""
