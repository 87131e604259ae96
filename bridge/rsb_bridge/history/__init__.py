"""The history of the last 24 hours, in memory and on disk."""
