"""System identification from flight logs: excerpts, output-error fits and how far they can be trusted.

It may import plant.
"""
