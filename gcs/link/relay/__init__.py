"""The relay between MAVSDK and the vehicles: bytes of a connection, which of them are a vehicle's, and signatures.

It may import mavsdk; the hub uses it.
"""
