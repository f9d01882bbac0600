"""The agent of one vehicle: it estimates, decides, plans, guards and sends, and talks to its peers.

`core` is the tick and `tape` records it; each folder may import the folders below it in the import contract of
pyproject.toml. Only `shell` knows clocks, sockets and asyncio.
"""
