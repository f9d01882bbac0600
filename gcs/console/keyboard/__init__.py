"""The keyboard of a flight: keys read from a terminal, their bindings, and the commands that they send."""
