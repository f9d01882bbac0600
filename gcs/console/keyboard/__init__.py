"""The keyboard of a flight: keys read from a terminal, what they mean, and the commands that they send."""
