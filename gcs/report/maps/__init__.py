"""Flights on maps: a flight log as KML, GPX or GeoJSON."""
