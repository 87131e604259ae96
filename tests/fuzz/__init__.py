"""Fuzzing of every parser that reads what a peer, a stranger or a file says (tests/README.md)."""
