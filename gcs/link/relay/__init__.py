"""The relay between MAVSDK and the vehicles: the bytes of a connection, the frames of each vehicle, and signatures.

It handles sockets and bytes and does not depend on MAVSDK; the hub uses it.
"""
