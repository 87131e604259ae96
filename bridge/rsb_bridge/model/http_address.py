"""Where an HTTP server listens, as one writes it: ``127.0.0.1:9464``, ``[::1]:9464``."""

from __future__ import annotations

from rsb_bridge.model.limits import PORT
from rsb_bridge.model.wording import Wording


class AddressProblem(Wording):
    """Why a text is no address of an HTTP server."""

    NOT_ADDRESS_AND_PORT = '{address!r} is not ADDRESS:PORT, as in 127.0.0.1:9464, or "[::1]:9464" in quotes'
    NO_ADDRESS = (
        "{address!r} names no address: give 127.0.0.1:{port} for programs of this machine, 0.0.0.0:{port} for every "
        "network"
    )
    NO_BRACKETS = '{address!r}: an IPv6 address stands in brackets, as in 127.0.0.1:9464, or "[::1]:9464" in quotes'
    INVALID_PORT = "{port!r} is not a port: {range}"


def host_and_port(text: str) -> tuple[str, int]:
    """The parts of an address; an IPv6 address stands in brackets.

    Raises:
        ValueError: it is not one; the message says what would be.
    """
    host, colon, port = text.rpartition(":")
    if not colon:
        raise ValueError(AddressProblem.NOT_ADDRESS_AND_PORT(address=text))
    if not host:
        raise ValueError(AddressProblem.NO_ADDRESS(address=text, port=port))
    bracketed = host.startswith("[") and host.endswith("]")
    if ":" in host and not bracketed:
        raise ValueError(AddressProblem.NO_BRACKETS(address=text))
    if not (port.isascii() and port.isdecimal() and len(port) <= 5 and int(port) in PORT):
        raise ValueError(AddressProblem.INVALID_PORT(port=port, range=PORT))
    return (host[1:-1] if bracketed else host), int(port)


def is_loopback(host: str) -> bool:
    """Whether only programs of this machine reach it."""
    return host in ("localhost", "::1") or host.startswith("127.")
