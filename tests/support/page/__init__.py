"""Helpers for tests and experiments of the operator's page: stations, their pictures, a browser, and measurements."""
