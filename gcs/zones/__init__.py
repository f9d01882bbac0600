"""Fences, no-fly zones and rally points that other programs drew: QGroundControl's plans, KML and GeoJSON."""
