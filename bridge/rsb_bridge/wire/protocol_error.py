"""What every reader raises when the peer breaks the format."""

from __future__ import annotations

from rsb_bridge.model.text import sanitize_text


class ProtocolError(Exception):
    """The peer broke the format; the message says how.

    It may quote the peer, and is for terminals and logs: what is unprintable is replaced, and what is too long is cut.
    """

    def __init__(self, message: str) -> None:
        super().__init__(sanitize_text(message))


class ForeignProtocolError(ProtocolError):
    """The peer is not an rsb-console.

    Attributes:
        protocol: the other program's, or an empty string if it is unknown.
    """

    def __init__(self, protocol: str = "") -> None:
        spoken = f" (it speaks {protocol})" if protocol else ""
        super().__init__(f"the other side is not an rsb-console{spoken}")
        self.protocol = protocol
