"""The configuration of one agent.

It may import estimation's settings and plant.
"""
