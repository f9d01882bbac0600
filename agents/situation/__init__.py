"""What one tick knows: the estimates, the centre of the ring, and the rate at which the vehicle goes around it.

It may import team, tactics and settings.
"""
