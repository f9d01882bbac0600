"""The supervisor process of a flight, the flying process's heartbeat to it, and the protocol between them.

It may import errors, signals and agents' ports.
"""
