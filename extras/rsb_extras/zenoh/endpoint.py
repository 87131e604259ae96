"""An endpoint of a Zenoh network: its own address, the samples for it, and the other endpoints it watches.

Keys, below ``rsb_console/FLEET``, where an address is 16 hexadecimal digits, new for each endpoint:

- ``at/TO/FROM/STREAM``: a sample for the endpoint TO; a stream is 16 hexadecimal digits, ``drop`` a datagram.
- ``here/SERVICE/ADDRESS/LABEL``: the liveliness token of an endpoint; its label is percent-encoded.

A sample's attachment has its `SampleKind`.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import re
import threading
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Protocol
from urllib.parse import quote, unquote

from rsb_bridge.feature_api import Wording, in_thread, sanitize_text
from rsb_bridge.wire.framing import STRANGER_LIMIT
from rsb_extras.zenoh.outbox import SampleOutbox
from rsb_extras.zenoh.sample_header import HEADER_LENGTHS, Header, SampleKind

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import zenoh

    from rsb_bridge.model.budgets import Strangers

ROOT = "rsb_console"
RECEIVE_BUFFER = 32 * 1024 * 1024
"""Bytes of peers that may wait for the loop; more are lost, as in a kernel's full buffer. A round figure."""
ASKED_WITHIN = 2.0
"""s that announcements are waited for: a round figure, as is the next one."""
MOST_SEEN = 10_000
"""Announcements that are kept; who is in a network may make any number of them."""

ROUTER_LOST = "the connection to the Zenoh router is lost"


class EndpointProblem(Wording):
    """Problems of an endpoint with the Zenoh network and its peers."""

    PEER_LEFT = "the other side has left the Zenoh network"


DATAGRAM = 60_000
"""Bytes of a datagram: with its key it fits one batch of Zenoh's, which loses it whole or not at all."""

_DATAGRAM = "drop"
_LABEL_LENGTH = 300
"""Characters that are kept of a label, which anybody writes."""
_OVERHEAD = 500
"""Bytes that a sample takes while it waits, beyond its payload."""
_AT_A_TIME = 256
"""Samples of peers that are taken in one turn of the loop: a round figure."""
_STRANGERS_AT_A_TIME = 16
"""Samples of strangers that are taken in one turn of the loop; each may cost a handshake. A round figure."""
_STRANGERS_WAIT = 256
"""Samples of strangers who have no answer yet that wait for the loop: more would be answered too late anyway."""
_CONFIRMED = 5.0
"""Seconds within which Zenoh has reported all present tokens to a new subscription: a round figure."""
_SETTLED = 0.1
"""s within which Zenoh reports a lost router after it has reported the endpoints behind it as gone: a round figure."""
_ADDRESS = re.compile("[0-9a-f]{16}")
"""Addresses of endpoints, and ids of streams; strangers may publish under any key."""


class Seen(NamedTuple):
    """Somebody who has announced an endpoint.

    Attributes:
        service: as in `rsb_extras.zenoh.network.Network.endpoint`.
        label: as its owner says, unauthenticated.
    """

    service: str
    address: str
    label: str


class _OfStranger(NamedTuple):
    """Work that a stranger has caused; `stream` is the sender's address and the stream, or None for an announcement."""

    stream: tuple[str, str] | None
    size: int
    work: Callable[[], None]


class StreamEnd(Protocol):
    """This side's end of a stream.

    Attributes:
        trusted: the other end has proven that it has the key.
        longest: bytes of the longest sample that it takes now.
        of_link: it carries a link's own messages, not a route's.
    """

    trusted: bool
    longest: int
    of_link: bool

    def arrived(self, header: Header, payload: bytes) -> None:
        """Take a sample."""

    def cut_off(self, reason: str) -> None:
        """End: the other end is gone, or cannot be reached any more."""

    def doubt(self, reason: str) -> None:
        """End unless a sample of the other side comes soon: somebody says that the other end is gone."""


class ZenohEndpoint:
    """An endpoint on the loop that made it; all but `cut_off` and `retire` must be called on that loop.

    Attributes:
        heard_at: time (s, on the loop's clock) of the last sample on a stream whose other end is proven.
        seen: present endpoints of the watched services, by address, including itself.
        on_stream: called with the sender's address, the id and the first header of a new stream; returns this side's
            end. Or None to refuse new streams.
        on_datagram: called with the sender's address and a payload, or None to drop datagrams.
        on_seen: called when an endpoint comes (True) or goes.
        when_retired: called once its session has a successor, for which another endpoint has to be made.
    """

    def __init__(
        self,
        session: zenoh.Session,
        fleet: str,
        service: str,
        label: str,
        watched: Sequence[str],
        strangers: Strangers,
        on_close: Callable[[ZenohEndpoint], None],
    ) -> None:
        import zenoh as package  # noqa: PLC0415 (an extra)

        self.address = os.urandom(8).hex()
        self.outbox = SampleOutbox(session, asyncio.get_running_loop())
        self.seen: dict[str, Seen] = {}
        self.on_stream: Callable[[str, str, Header], StreamEnd] | None = None
        self.on_datagram: Callable[[str, bytes], None] | None = None
        self.on_seen: Callable[[Seen, bool], None] = _nobody
        self.when_retired: Callable[[], None] = _nothing
        self.session = session
        self._retired = False
        self._put, self._closed_error = package.SampleKind.PUT, package.ZError
        self._root = f"{ROOT}/{fleet}"
        self._service, self._label, self._watched = service, label, watched
        self._strangers = strangers
        self._on_close = on_close
        self._directly = package.handlers.Callback
        self._loop = asyncio.get_running_loop()
        self.heard_at = self._loop.time()
        self._do_now: Callable[[Callable[[], None]], bool] | None = getattr(self._loop, "do_now", None)
        self._streams: dict[tuple[str, str], StreamEnd] = {}
        self._peers: dict[str, int] = {}  # addresses, and how many trusted streams each has
        self._arrivals: deque[Callable[[], None]] = deque()
        self._of_strangers: deque[_OfStranger] = deque()
        self._waiting_bytes = 0
        self._counting = threading.Lock()
        self._woken = False
        self._unconfirmed: set[str] = set()
        self._declared: list[zenoh.Subscriber[None] | zenoh.LivelinessToken] = []

    async def announce(self) -> None:
        """Begin to receive, know who is there, and let all see that this endpoint is."""
        for service in self._watched:  # before any declaration, after which Zenoh answers from its own state
            for seen in await self.ask(service):
                self._announced(seen, comes=True)
        self._unconfirmed = set(self.seen)
        self._loop.call_later(_CONFIRMED, self._forget_unconfirmed)
        session, root = self.session, self._root
        live = session.liveliness()
        watched = [f"{root}/here/{service}/*/*" for service in self._watched]
        self._declared = [
            # On the thread that receives: Zenoh's own queue between that one and another has no limit.
            session.declare_subscriber(f"{root}/at/{self.address}/*/*", self._directly(self._sample, indirect=False)),
            *(live.declare_subscriber(key, self._announcement, history=True) for key in watched),
            # Last: peers that see it may call at once.
            live.declare_token(f"{root}/here/{self._service}/{self.address}/{quote(self._label, safe='') or '-'}"),
        ]

    def close(self) -> None:
        """Leave the network. Streams have to be closed before."""
        for each in self._declared:
            self._undeclare(each)
        self._declared = []
        self.outbox.close()
        self._on_close(self)

    def _undeclare(self, declared: zenoh.Subscriber[None] | zenoh.LivelinessToken) -> None:
        with contextlib.suppress(Exception):  # the network is closed already
            declared.undeclare()  # type: ignore[no-untyped-call]

    async def ask(self, service: str) -> list[Seen]:
        """Return the present endpoints of a service, as routers know them."""
        key = f"{self._root}/here/{service}/*/*"

        def collect() -> list[Seen]:
            try:
                replies = self.session.liveliness().get(key, timeout=ASKED_WITHIN)
            except self._closed_error as error:
                raise OSError(f"Zenoh: {error}") from None
            found = (_seen(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None)
            return [seen for seen in itertools.islice(found, MOST_SEEN) if seen is not None]

        try:
            return await in_thread("zenoh-ask", collect, 2 * ASKED_WITHIN)
        except TimeoutError:
            raise OSError("the Zenoh network does not list its members: is its router busy?") from None

    # --- streams

    def key(self, to: str, stream: str = _DATAGRAM) -> str:
        """Return the key of samples for another endpoint."""
        return f"{self._root}/at/{to}/{self.address}/{stream}"

    def add(self, peer: str, stream: str, end: StreamEnd) -> None:
        """Give a stream's samples to its end."""
        self._streams[peer, stream] = end
        if end.trusted:
            self.trust(peer, stream)

    def trust(self, peer: str, stream: str) -> None:
        """Move the waiting samples of a stream that is marked as trusted out of the strangers' queue."""
        self._peers[peer] = self._peers.get(peer, 0) + 1
        with self._counting:
            waiting, self._of_strangers = self._of_strangers, deque()
            for each in waiting:
                if each.stream == (peer, stream):
                    self._arrivals.append(partial(self._take_of_stranger, each))
                else:
                    self._of_strangers.append(each)

    def forget(self, peer: str, stream: str) -> None:
        """Forget a stream that is over."""
        end = self._streams.pop((peer, stream), None)
        if end is not None and end.trusted:
            self._peers[peer] -= 1
            if not self._peers[peer]:
                del self._peers[peer]
        self._leave_if_unused()

    @property
    def carries_link(self) -> bool:
        """Whether a link's own stream is up here."""
        return any(each.of_link and each.trusted for each in self._streams.values())

    def retire(self) -> None:
        """Leave the network with the last stream: its session has a successor. May be called from any thread."""
        self._soon(self._retire)

    def _retire(self) -> None:
        self._retired = True
        self.on_stream = None
        if self._declared:
            self._undeclare(self._declared.pop())  # its announcement: nobody else is to call
        self.when_retired()
        self._leave_if_unused()

    def _leave_if_unused(self) -> None:
        if self._retired and self._declared and not self._streams:
            self.close()

    def cut_off(self, reason: str) -> None:
        """End all streams, because nothing gets through any more. May be called from any thread."""
        self._soon(lambda: self._end_all(reason))

    def _end_all(self, reason: str) -> None:
        for end in tuple(self._streams.values()):
            end.cut_off(reason)

    # --- on Zenoh's threads

    def _sample(self, sample: zenoh.Sample) -> None:
        """Queue a sample for the loop, unless it is too long: nothing of that one is copied."""
        payload, attachment = sample.payload, sample.attachment
        length = len(payload)
        *_, sender, stream = str(sample.key_expr).rsplit("/", 2)
        # Anybody may send datagrams. They are copied only if the sender has a stream that is proven.
        if stream == _DATAGRAM:
            if sender in self._peers and length <= DATAGRAM:
                content = payload.to_bytes()
                self._within_budget(length, lambda: self._receive_datagram(sender, content))
            return
        end = self._streams.get((sender, stream))
        if end is None and not (_ADDRESS.fullmatch(sender) and _ADDRESS.fullmatch(stream)):
            return
        if attachment is None or len(attachment) not in HEADER_LENGTHS:
            return
        if length > (STRANGER_LIMIT if end is None else end.longest):
            self._strangers.turn_away()
            return
        header, content = attachment.to_bytes(), payload.to_bytes()
        # A stream notices losses by the samples' numbers.
        take = partial(self._receive, sender, stream, header, content)
        if end is not None and end.trusted:
            self.heard_at = self._loop.time()
            # Here, if the loop waits. A link's own messages may end the session, which waits for this thread.
            if end.of_link or self._arrivals or self._do_now is None or not self._do_now(take):
                self._within_budget(length, take)
        elif not self._queue_of_stranger(length, take, (sender, stream)):
            self._within_budget(length, take)

    def _announcement(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        seen, comes = _seen(key), sample.kind == self._put
        if seen is not None:
            self._queue_of_stranger(len(key), partial(self._announced, seen, comes=comes))

    def _within_budget(self, length: int, work: Callable[[], None]) -> None:
        size = length + _OVERHEAD
        with self._counting:
            if self._waiting_bytes + size > RECEIVE_BUFFER:
                return
            self._waiting_bytes += size

        def take() -> None:
            with self._counting:
                self._waiting_bytes -= size
            work()

        self._soon(take)

    def _queue_of_stranger(self, length: int, work: Callable[[], None], stream: tuple[str, str] | None = None) -> bool:
        """Queue what a stranger has caused, or drop it. Return False if the stream is a peer's."""
        size = length + _OVERHEAD
        with self._counting:  # keeps the order while the loop marks the stream as trusted
            end = self._streams.get(stream) if stream is not None else None
            if end is not None and end.trusted:
                return False
            answered = stream is None or (end is not None and end.longest > STRANGER_LIMIT)
            if not answered and len(self._of_strangers) >= _STRANGERS_WAIT:
                self._strangers.turn_away()
            elif self._strangers.take(size):
                self._of_strangers.append(_OfStranger(stream, size, work))
        self._wake()
        return True

    def _soon(self, work: Callable[[], None]) -> None:
        self._arrivals.append(work)
        self._wake()

    def _wake(self) -> None:
        if not self._woken:
            self._woken = True
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._turn)

    # --- on the loop

    def _turn(self) -> None:
        self._woken = False  # first: what is queued from here on wakes the loop again
        # One that fails holds up no other's.
        try:
            for _ in range(min(len(self._arrivals), _AT_A_TIME)):
                self._arrivals.popleft()()
            for _ in range(min(len(self._of_strangers), _STRANGERS_AT_A_TIME)):
                if self._of_strangers:  # one that becomes trusted takes its further samples along
                    self._take_of_stranger(self._of_strangers.popleft())
        finally:
            if (self._arrivals or self._of_strangers) and not self._woken:
                self._woken = True
                self._loop.call_soon(self._turn)  # others have their turn first

    def _take_of_stranger(self, each: _OfStranger) -> None:
        self._strangers.give(each.size)
        each.work()

    def _receive_datagram(self, sender: str, payload: bytes) -> None:
        if self.on_datagram is not None:
            self.on_datagram(sender, payload)

    def _receive(self, sender: str, stream: str, attachment: bytes, payload: bytes) -> None:
        header = Header.unpack(attachment)
        if header is None:
            return
        end = self._streams.get((sender, stream))
        if end is None:
            if header.kind != SampleKind.DATA:
                return
            if self.on_stream is None or header.number:
                # Anyone can cause these, so they wait for nothing.
                over = Header(SampleKind.END, header.rank, 0)
                self.outbox.drop(self.key(sender, stream), b"there is no such stream any more", over)
                return
            end = self.on_stream(sender, stream, header)
        end.arrived(header, payload)

    def _announced(self, seen: Seen, *, comes: bool) -> None:
        known = self.seen.get(seen.address)
        self._unconfirmed.discard(seen.address)
        if comes:
            if known is not None:
                return  # a token with another endpoint's address does not replace it
            if len(self.seen) >= MOST_SEEN:
                self._forget_oldest()
            self.seen[seen.address] = seen
        else:
            if known != seen:  # a token with another endpoint's address goes
                return
            del self.seen[seen.address]
            # Where the router is lost, Zenoh says this first, of everybody.
            self._loop.call_later(_SETTLED, self._gone, seen.address)
        self.on_seen(seen, comes)

    def _forget_oldest(self) -> None:
        """Make room for a new announcement: strangers must not hide it by making as many as are kept."""
        busy = {self.address, *(peer for peer, _ in self._streams)}
        oldest = next((address for address in self.seen if address not in busy), None)
        if oldest is not None:
            self.on_seen(self.seen.pop(oldest), False)

    def _forget_unconfirmed(self) -> None:
        """Forget endpoints that no subscription has reported: they went before it was declared."""
        for address in self._unconfirmed & set(self.seen):
            self._announced(self.seen[address], comes=False)

    def _gone(self, address: str) -> None:
        """Have the streams of an endpoint ask whether it is there: anybody may declare its token, and undeclare it."""
        reason = EndpointProblem.PEER_LEFT() if self.session.info.transports() else ROUTER_LOST
        for (peer, _), end in tuple(self._streams.items()):
            if peer == address:
                end.doubt(reason)


def _seen(key: str) -> Seen | None:
    *_, service, address, label = key.rsplit("/", 3)
    if not _ADDRESS.fullmatch(address):
        return None
    return Seen(service, address, sanitize_text(unquote(label), _LABEL_LENGTH) if label != "-" else "")


def _nobody(_: Seen, __: bool) -> None:
    """Nobody watches."""


def _nothing() -> None:
    """Nobody needs another endpoint."""
