"""The planners: formation, encirclement, return and excitation, and the LMPC and feedback linearisation they use.

It may import ring, safety, situation, team and settings.
"""
