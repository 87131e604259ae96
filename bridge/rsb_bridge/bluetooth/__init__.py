"""Bluetooth adapters, their channels, and devices that are paired or connected."""
