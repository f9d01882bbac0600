"""The MAVSDK link of a vehicle, which implements `agents.ports.VehicleLink`.

It may import mission; with the reader in preflight it is the only importer of mavsdk.
"""
