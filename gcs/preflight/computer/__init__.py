"""This computer before a flight on the wall's clock: how late its timers are, what keeps it busy, and its priority."""
