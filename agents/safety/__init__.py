"""Safety, independent of the planner: guard, barriers, fence, fault detection and the failsafe table.

It may import situation, team and settings, and no planner.
"""
