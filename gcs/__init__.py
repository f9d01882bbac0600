"""The ground station: missions, links, flights, logs, reports and the command line.

Each folder may import the folders below it in the import contract of pyproject.toml, and agents, sitl and estimation.
"""
