"""States, frames, plants, filters and identification.

It imports none of the other packages.
"""
