"""The rates of what a connection carries: how many bytes they take, and which rates fit.

Pure: what arrived and what the time is are arguments.
"""
