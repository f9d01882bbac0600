"""The ring: feasibility, places and spacing, moving references, joining, headway and detours.

It may import settings, team and estimation; control uses it.
"""
