"""The errors that every reader raises when the peer breaks the format, and their texts."""

from __future__ import annotations

from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording


class Broken(Wording):
    """The ways in which a peer can break the format."""

    FOREIGN = "the other side is not an rsb-console"
    FOREIGN_KNOWN = "the other side is not an rsb-console (it speaks {protocol})"
    TOO_LONG_IN_CHUNKS = "a message of more than {limit} bytes in chunks"
    TOO_MUCH_INCOMPLETE = "the link's incomplete messages would take more than {limit:,} bytes"
    FRAME_TOO_LONG = "a frame of {length} bytes; the limit is {limit}"
    DATA_FRAME_TOO_SHORT = "a data frame of {length} bytes: its header alone has {header}"
    INVALID_CONTROL_MESSAGE = "invalid control message: {problem}"
    UNKNOWN_PREAMBLE = "unknown preamble kind {kind}"
    CONTROL_TOO_SHORT = "a CONTROL frame ends before its name or its fingerprint does"
    NAME_NOT_UTF8 = "the name in a {frame} frame is not UTF-8"
    NAME_UNPRINTABLE = "the name in a {frame} frame has unprintable characters"
    DATA_TOO_SHORT = "a DATA frame ends before its proof"
    UNKNOWN_SUITE = "unknown cipher suite"
    UNKNOWN_REFUSAL = "unknown refusal code"
    LEASE_HEADER_TOO_SHORT = "a lease header of {length} bytes: it has {expected}"
    HISTORY_HEADER_TOO_SHORT = "a history header of {length} bytes: it has {expected}"
    HISTORY_HEADER_INVALID = "a history header with message number {number} and a depth of {depth}"
    CALL_FRAME_TOO_SHORT = "a call frame of {length} bytes: its header alone has {header}"
    CALL_KIND_UNKNOWN = "a call frame of unknown kind {kind}"
    CALL_NUMBER_INVALID = "a call frame of kind {kind} with the number {number}"
    CALL_DURATION_INVALID = "a call frame of kind {kind} that took {took} ns"
    HANDSHAKE_TOO_SHORT = "a handshake message of {length} bytes is too short"
    EPHEMERAL_KEY_INVALID = "the peer's ephemeral key is invalid"
    UNEXPECTED_ON_CONTROL = "unexpected frame on the control connection, header {header}"
    UNEXPECTED_IN_PREAMBLE = "unexpected {kind} frame in the preamble"
    RETRY_IGNORED = "the client offers AES-GCM again after a RETRY with ChaCha20-Poly1305"
    HANDSHAKE_REPLAYED = "the first message of {name!r} is replayed: it has come before"
    NAMES_DIFFER = "the client's name is {preamble!r} in the preamble and {hello!r} in its Hello"
    NOT_CONFIRMED = "the {peer} did not confirm the handshake"
    PROBE_INVALID = "a probe of {length} bytes"
    RECEIPT_INVALID = "a receipt of {length} bytes"
    OPERATOR_TOO_SHORT = "an OPERATOR frame ends before its {field}"
    DATA_AGAINST_ROUTE = "data on route {route}, which goes the other way"
    HANDLED_WRONG = (
        "the peer has handled {count} control messages of this association, and cannot: this side has sent {sent}, "
        "and knows that {acknowledged} were handled"
    )
    RESUMED_WRONG = "route {route} goes on after message {told} on another stream, and cannot"
    FRAME_OF_UNKNOWN_ROUTE = "a frame of type {kind}, route {route} on a stream that does not carry it"


class Misuse(Wording):
    """Requests of this side's own that the format has no room for."""

    NAME_TOO_LONG = "the name has {length} bytes in UTF-8, and at most {limit} are allowed: choose a shorter one"
    CONTROL_MESSAGE_TOO_LONG = "a control message of {length} bytes; a control frame has {limit}"
    TOO_MANY_DATAGRAMS = "a message of {length} bytes takes more than {limit} datagrams: use tcp"
    NOT_ESTABLISHED = "nothing can be sent before the connection is established"
    KEY_LENGTH = "{suite} takes a key of {expected} bytes"
    SESSION_KEY_LENGTH = "a session key has {expected} bytes, not {length}"
    NO_KEY_LEFT = "route {route} was not proposed on this connection, or its key is in use: each key is handed out once"


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
        super().__init__(Broken.FOREIGN_KNOWN(protocol=protocol) if protocol else Broken.FOREIGN())
        self.protocol = protocol
