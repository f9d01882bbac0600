"""The report of a flight: what is to be seen of it, its figures, and the page."""
