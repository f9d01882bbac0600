"""The bundled stub: simulated vehicles with a MAVLink interface, and a simulation without sockets.

It imports estimation only, neither agents nor gcs.
"""
