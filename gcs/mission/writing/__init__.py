"""What helps a person to write a mission: where in the text a fault is, the JSON Schema, and a new mission's text.

It may import the sections of missions, not the reader of mission files.
"""
