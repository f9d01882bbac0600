"""An emulated radio: delay, loss and noise of frames. Pure: bytes and times are arguments."""
