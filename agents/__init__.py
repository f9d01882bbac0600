"""The agent of one vehicle: it estimates, decides, plans, guards, and sends setpoints and messages.

`core` is the tick and `recording` records it; each folder may import the folders below it in the import contract of
pyproject.toml. Only `shell` uses clocks, sockets and asyncio.
"""
