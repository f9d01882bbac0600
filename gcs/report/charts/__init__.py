"""The charts of a report, each drawn as SVG from evidence.

It may import report.evidence, metrics and style.
"""
