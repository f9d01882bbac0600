"""System identification from flight logs: excerpts, output-error fits and their grading.

It may import plant.
"""
