"""Faults that are injected into a flight of stub vehicles: by drills one by one, by `fly --fault` at given times."""
