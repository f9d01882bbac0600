"""The relay between MAVSDK and the vehicles: bytes of a connection, which of them are a vehicle's, and signatures.

It knows sockets and bytes, not MAVSDK; the hub uses it.
"""
