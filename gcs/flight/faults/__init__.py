"""Faults that are injected into a flight of stub vehicles: by drills one by one, and in practice at given times."""
