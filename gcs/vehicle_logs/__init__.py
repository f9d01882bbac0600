"""Logs of autopilots and other programs behind one reader interface: ULog, DataFlash, telemetry logs and cordon's own.

It may import flightlog for cordon's own logs.
"""
