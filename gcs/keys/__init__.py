"""The keys of a team: who may join its bus, and what each may send. Certificates, roles, and their folders.

It may import mission and agents' settings of the bus; console, flight and what is above them use it.
"""
