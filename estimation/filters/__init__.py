"""The Kalman filters of the own vehicle and of the target, and the tests of their consistency.

It may import plant.
"""
