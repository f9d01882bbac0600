"""Messages between vehicles, and each vehicle's record of its peers.

It may import tactics and settings.
"""
