"""The MAVSDK link of a vehicle, behind the seam `agents.ports.VehicleLink`.

It may import mission; with the reader in preflight it is the only importer of mavsdk.
"""
