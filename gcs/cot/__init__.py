"""Cursor-on-Target: a running team on the maps of TAK and others, and a target from them."""
