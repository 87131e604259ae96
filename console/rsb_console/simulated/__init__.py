"""Simulated fleets: what ``rsb-console demo --fleet`` runs, and bench/ builds on."""
