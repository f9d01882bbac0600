"""The shell around the core: the event loop, a flight from take-off to landing, the start agreement and Zenoh.

It may import everything in agents; nothing in agents imports it.
"""
