"""Where an HTTP server listens, as one writes it: ``127.0.0.1:9464``, ``[::1]:9464``."""

from __future__ import annotations

from rsb_bridge.model.limits import PORT

_EXAMPLE = 'as in 127.0.0.1:9464, or "[::1]:9464" in quotes'


def host_and_port(text: str) -> tuple[str, int]:
    """The parts of an address; an IPv6 address stands in brackets.

    Raises:
        ValueError: it is not one; the message says what would be.
    """
    host, colon, port = text.rpartition(":")
    if not colon:
        raise ValueError(f"{text!r} is not ADDRESS:PORT, {_EXAMPLE}")
    if not host:
        which = f"127.0.0.1:{port} for programs of this machine, 0.0.0.0:{port} for every network"
        raise ValueError(f"{text!r} names no address: give {which}")
    bracketed = host.startswith("[") and host.endswith("]")
    if ":" in host and not bracketed:
        raise ValueError(f"{text!r}: an IPv6 address stands in brackets, {_EXAMPLE}")
    if not (port.isascii() and port.isdecimal() and len(port) <= 5 and int(port) in PORT):
        raise ValueError(f"{port!r} is not a port: {PORT}")
    return (host[1:-1] if bracketed else host), int(port)


def is_loopback(host: str) -> bool:
    """Whether only programs of this machine reach it."""
    return host in ("localhost", "::1") or host.startswith("127.")
