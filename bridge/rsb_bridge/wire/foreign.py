"""Protocols of other programs, recognised by the first bytes that they send."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.wire.sealing import Buffer

_HTTP = (b"HTTP", b"GET ", b"HEAD ", b"POST ", b"PUT ", b"DELETE ", b"OPTIONS ", b"CONNECT ", b"PATCH ", b"TRACE ")
_BEGINNINGS: tuple[tuple[str, tuple[bytes, ...]], ...] = (
    ("HTTP", (*_HTTP, b"PRI * HTTP", b"<!DO", b"<!do", b"<htm", b"<HTM", b"<?xm")),  # HTTP/0.9 answers without a header
    ("SSH", (b"SSH-",)),
    ("TLS", tuple(bytes((kind, 3, minor)) for kind in (0x15, 0x16) for minor in range(5))),
    ("RTPS", (b"RTPS", b"RTCP")),
    ("Redis", (b"-ERR", b"+PONG", b"*1\r\n")),
    ("FTP or SMTP", (b"220 ", b"220-", b"EHLO", b"HELO")),
    ("VNC", (b"RFB ",)),
)
_ZENOH = "Zenoh"
_ZENOH_CLOSE = bytes.fromhex("020003")
"""Two bytes of length, and the message by which a router refuses a program that does not speak Zenoh."""
_ZENOH_INIT = 0x01
_ZENOH_VERSIONS = (0x08, 0x09)


def recognise(data: Buffer) -> str:
    """Return the name of the protocol that a stream begins with, or an empty string if it is not a known one.

    Args:
        data: the first bytes, at least four.
    """
    start = bytes(data[:16])
    for name, beginnings in _BEGINNINGS:
        if any(start.startswith(each) or each.startswith(start) for each in beginnings):
            return name
    # A Zenoh client begins with two bytes of length, INIT and the version.
    is_init = len(start) >= 4 and start[2] & 0x1F == _ZENOH_INIT and start[3] in _ZENOH_VERSIONS
    return _ZENOH if is_init or start.startswith(_ZENOH_CLOSE) else ""
