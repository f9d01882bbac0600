"""The audit log: which operator commanded what, and what each vehicle did, as a chain of hashes.

The folder above it writes and reads it; it may import agents.
"""
