"""The shell around the core: the event loop, the take-off to landing of one vehicle, the start agreement and Zenoh.

It may import everything in agents; nothing in agents imports it.
"""
