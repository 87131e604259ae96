"""What a stream's state machine says happened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from rsb_bridge.wire.messages import ControlMessage, Hello, Welcome
    from rsb_bridge.wire.opening import RefusalCode
    from rsb_bridge.wire.sealing import SessionKeys


@dataclass(frozen=True, slots=True)
class Established:
    """The control connection stands, and the peer is proven to hold the key.

    Attributes:
        peer: what it says of itself: a `Welcome` on the client, a `Hello` on the server.
        keys: for the link's data.
    """

    peer: Hello | Welcome
    keys: SessionKeys


@dataclass(frozen=True, slots=True)
class Received:
    """A control message came."""

    message: ControlMessage


@dataclass(frozen=True, slots=True)
class DataFrame:
    """A data frame came on a multiplexed control stream.

    Attributes:
        route: as its header says; not authenticated yet.
        frame: for the route's `rsb_bridge.wire.framing.DataReader.open_frame`.
    """

    route: int
    frame: memoryview


@dataclass(frozen=True, slots=True)
class Attach:
    """Server: the stream wants to be a link's data stream. Answer with `ServerConnection.accept_attach` or `refuse`.

    Attributes:
        link_id: 8 bytes.
        route: its id.
        proof: for `rsb_bridge.wire.sealing.SessionKeys.check_attach_proof`.
        header: what the proof is over.
    """

    link_id: bytes
    route: int
    proof: bytes
    header: bytes


@dataclass(frozen=True, slots=True)
class Accepted:
    """Client: the server took the data stream."""


@dataclass(frozen=True, slots=True)
class Refused:
    """The stream is not let in. It is over: send what is to be sent, then close.

    Attributes:
        code: why.
        words: why, in words.
        by_peer: the peer refused; else this side did.
    """

    code: RefusalCode
    words: str
    by_peer: bool


@dataclass(frozen=True, slots=True)
class Failed:
    """The peer broke the format, or a seal does not hold. It is over: send what is to be sent, then close."""

    reason: str


Event: TypeAlias = Established | Received | DataFrame | Attach | Accepted | Refused | Failed
