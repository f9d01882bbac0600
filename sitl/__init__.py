"""The stand-in for hardware: stub autopilots over MAVLink, a world with a target, and a simulation in one process."""
