"""Meters, watches, event log and snapshots of the engine."""
