"""The bundled stub: simulated vehicles that speak MAVLink, and a simulation without sockets.

It imports estimation only, neither agents nor gcs.
"""
