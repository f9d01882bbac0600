"""An emulated radio: what it does to the frames that it carries. Pure: bytes and times are arguments."""
