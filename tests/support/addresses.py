"""Addresses of another machine."""

from __future__ import annotations

import socket


def foreign_address() -> str:
    """Return an address for documentation (RFC 5737) that this machine does not have; some machines have such ones."""
    return next(address for number in range(1, 255) if not _is_own(address := f"203.0.113.{number}"))


def _is_own(address: str) -> bool:
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, 0))
        except OSError:
            return False
    return True
