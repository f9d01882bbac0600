"""Helpers for tests and experiments of the operator's page: stations, their pictures, and a browser."""
