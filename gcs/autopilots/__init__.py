"""What is special about each autopilot, in a file of its own: modes, messages, parameters and the advice about them.

It may import estimation.
"""
