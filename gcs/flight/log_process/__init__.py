"""The process that writes a flight's log and serves it to viewers: the flying process's handle on it, and its program.

Encoding, drawing and compressing hold the interpreter lock: in the flying process they would delay the control loops.
"""
