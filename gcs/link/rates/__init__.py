"""The message rates of a connection: the bytes that they take, and the rates that fit.

Pure: received counts and times are arguments.
"""
