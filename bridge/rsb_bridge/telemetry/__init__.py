"""What the engine measures and says: meters, events, snapshots."""
