"""What the engine measures and reports: meters, events, snapshots."""
