"""The command line: what a user types, parsed and handed over, and what is printed.

It may import every folder of gcs; nothing imports it.
"""
