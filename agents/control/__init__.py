"""The planners: formation, encirclement, return and excitation, and the LMPC and feedback linearisation they use.

It may import safety, situation, team and settings.
"""
