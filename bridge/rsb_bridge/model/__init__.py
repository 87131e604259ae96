"""Plain data that every layer shares: sessions, QoS, snapshots, limits. Imports no other layer."""
