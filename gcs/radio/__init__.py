"""An emulated radio between a station and its vehicles, over sockets and serial lines."""
