"""Sockets: TCP, UDP and Bluetooth RFCOMM."""
