"""Meters, watches, event log, snapshots and metrics of the engine."""
