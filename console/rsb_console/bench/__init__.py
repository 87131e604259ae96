"""Benchmarks and simulated fleets: what ``rsb-console bench`` and ``demo --fleet`` run, and bench/ builds on."""
