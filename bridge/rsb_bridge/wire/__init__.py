"""The wire format, sans-IO: bytes in, events out. See PROTOCOL.md."""
