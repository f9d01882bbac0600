"""The dynamics of a simulated vehicle: body, shaping, wind, estimator wander and telemetry times.

It imports estimation only.
"""
