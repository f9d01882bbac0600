"""The topics of sensors outside the team on its bus."""

from agents.team import external_positions, perception

SENSOR_TOPICS = frozenset({perception.TOPIC, external_positions.TOPIC})
"""Sightings of the target, and positions of vehicles."""
