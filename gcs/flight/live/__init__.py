"""Flights that a program operates: the program, the flying process that it starts, and what they exchange."""
