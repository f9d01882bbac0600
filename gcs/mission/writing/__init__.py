"""Help for people who write missions: the line of a fault, the JSON Schema, and the text of a new mission.

It may import the sections of missions, not the reader of mission files.
"""
