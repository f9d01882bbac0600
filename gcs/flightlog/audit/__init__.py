"""The audit log: each operator's commands and each vehicle's answers, as a chain of hashes.

The folder above it writes and reads it; it may import agents.
"""
