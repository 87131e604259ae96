"""The events of a stream's state machine."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from rsb_bridge.wire.messages import Hello, Welcome
    from rsb_bridge.wire.sealing import ConnectionKeys


class RefusalCode(IntEnum):
    WRONG_VERSION = 1
    WRONG_KEY = 2
    UNKNOWN_NAME = 3
    ENCRYPTION_REQUIRED = 4
    ENCRYPTION_NOT_POSSIBLE = 5
    BAD_FORMAT = 6
    NO_SUCH_ROUTE = 7
    BUSY = 8
    NAME_TAKEN = 9
    SHUT_DOWN = 10


@dataclass(frozen=True, slots=True)
class Established:
    """The control connection is up, and the peer has proven that it has the key."""

    peer: Hello | Welcome  # its `Welcome` on the client, its `Hello` on the server
    keys: ConnectionKeys
    answer: Welcome | None = None  # the server's own


@dataclass(frozen=True, slots=True)
class MessageReceived:
    """A control message came, for `rsb_bridge.wire.codec.decode`, which may take a while: so its receiver calls it."""

    content: bytes


@dataclass(frozen=True, slots=True)
class DataFrame:
    """A data frame came on a multiplexed control stream."""

    frame: memoryview  # for the route's `rsb_bridge.wire.framing.DataReader.open_frames`


class StreamName(NamedTuple):
    """The place of a data stream in its link."""

    number: int
    """Counts the data streams of the link's life, from 1; a later stream of one place replaces an earlier one."""
    port: int = 0  # that its routes name, or 0 for the link's own
    large: bool = False


@dataclass(frozen=True, slots=True)
class Attach:
    """Server: the client asks to use the stream for data. Answer with `ServerConnection.accept_attach` or `refuse`."""

    link_id: bytes  # 8 bytes
    name: StreamName
    proof: bytes  # for `rsb_bridge.wire.sealing.ConnectionKeys.check_attach_proof`
    header: bytes  # what the proof authenticates


@dataclass(frozen=True, slots=True)
class Accepted:
    """Client: the server accepted the data stream."""


@dataclass(frozen=True, slots=True)
class StreamRefused:
    """One side refused the stream. Send the remaining bytes, then close it."""

    code: RefusalCode
    message: str  # the reason in words, for an operator
    peer: Hello | None = None  # the refused client if it has proven that it has the key, or None


@dataclass(frozen=True, slots=True)
class Failed:
    """The peer broke the format, or a seal is invalid. Send the remaining bytes, then close the stream."""

    reason: str
    foreign: str | None = None
    """The other program's protocol, empty if it is unknown, or None if the peer is an rsb-console."""


@dataclass(frozen=True, slots=True)
class Admitted:
    """An operator's connection is up, and the peer has proven that it has the operator's key."""

    host: str = ""
    """On the engine, the machine that they come from, as their console says; this and the key are empty on the
    console."""
    key: bytes = field(default=b"", repr=False)  # not in a log


@dataclass(frozen=True, slots=True)
class OperatorOpened:
    """The next bytes of an operator's connection."""

    content: bytes = field(repr=False)


Event: TypeAlias = (
    Established | MessageReceived | DataFrame | Attach | Accepted | StreamRefused | Failed | Admitted | OperatorOpened
)
