"""Bluetooth adapters, their channels, and devices in range."""
