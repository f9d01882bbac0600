"""The dynamics of a simulated vehicle: body, shaping, wind, drift of its estimator and telemetry timing.

It imports estimation only.
"""
