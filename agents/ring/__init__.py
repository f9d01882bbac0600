"""The ring as it is flown: places and spacing on it, references that move between them, the way there and around.

It may import settings, team and estimation; control uses it.
"""
