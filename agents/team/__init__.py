"""What vehicles send one another, and what each knows of its peers.

It may import tactics and settings.
"""
