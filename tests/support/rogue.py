"""A client that holds the key and does what no robot would: it begins messages and never ends them."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from typing import TYPE_CHECKING, Any, Self, TypeVar

from tests.support.frames import write_frame

from rsb_bridge.model.qos import Qos
from rsb_bridge.wire.codec import decoders
from rsb_bridge.wire.connection import ClientConnection, DataConnection
from rsb_bridge.wire.datagram import DatagramWriter, Probe
from rsb_bridge.wire.events import Accepted, Established, MessageReceived, StreamName
from rsb_bridge.wire.framing import CONTROL_LIMIT, MESSAGE_LIMIT, MORE, DataWriter
from rsb_bridge.wire.messages import Accept, ControlMessageBase, Describe, Hello, Propose, Ready, Refuse
from rsb_bridge.wire.records import Source
from rsb_bridge.wire.sealing import PROBE_ROUTE, CipherSuite

if TYPE_CHECKING:
    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.wire.events import Event
    from rsb_bridge.wire.sealing import ConnectionKeys

T = TypeVar("T")
BLOB = ("made_up_msgs/msg/Blob", "RIHS01_" + "5a" * 32)
"""A type that nobody has, and its hash."""


def whole(content: bytes) -> ControlMessageBase:
    """A control message, features' too, with all its entries, however long."""
    return decoders()[0].decode(content)


class Rogue:
    """A link to a server, made by hand, on blocking sockets.

    Attributes:
        keys: what the handshake left.
        streams: of its routes, as long as it lives.
        probes: writes the probes of its datagrams' path.
    """

    def __init__(
        self,
        port: int,
        key: bytes | None,
        name: str = "robot1",
        *,
        host: str = "127.0.0.1",
        timeout: float = 60.0,
        features: tuple[str, ...] = (),
    ) -> None:
        self._address = (host, port)
        self._timeout = timeout
        self._connection = ClientConnection(
            Hello("0.1.0", name, "rogue", 0, features=features), key, CipherSuite.AESGCM
        )
        self._control = socket.create_connection(self._address, timeout=timeout)
        self._control.sendall(self._connection.start())
        self._saying = threading.Lock()
        self._events: list[Event] = []
        self._next_route = 1
        self.streams: list[socket.socket] = []
        self.udp = socket.socket(self._control.family, socket.SOCK_DGRAM)
        self.udp.connect(self._address)
        self.keys: ConnectionKeys = self.wait_for(Established).keys
        self.probes = DatagramWriter(self.keys.route_sealer(PROBE_ROUTE, "client"), self.keys.link_id, PROBE_ROUTE)

    def wait_for(self, *kinds: type[T]) -> T:
        """Return the next event or control message of these kinds, and drop all before it."""
        while True:
            for index, event in enumerate(self._events):
                said = whole(event.content) if isinstance(event, MessageReceived) else event
                if isinstance(said, kinds):
                    del self._events[: index + 1]
                    return said
            data = self._control.recv(CONTROL_LIMIT)
            assert data, f"the server closed the connection before it said any of {kinds}"
            self._events = self._connection.receive_data(data)
            self._control.sendall(self._connection.data_to_send())

    def say(self, *messages: ControlMessageBase) -> None:
        """Send control messages, all at once. From any thread."""
        with self._saying:
            for message in messages:
                if isinstance(message, Propose):
                    self.keys.proposed(message.route, "client")
            self._control.sendall(b"".join(self._connection.send(message) for message in messages))

    def say_raw(self, content: bytes) -> None:
        """Send bytes in place of a control message."""
        self._control.sendall(self._connection._seal(content))

    def new_route(self) -> int:
        """An id that no route has had."""
        number = self._next_route
        self._next_route += 2
        return number

    def route(self, topic: str, transport: str, qos: Qos, kind: tuple[str, str] = BLOB) -> int:
        """Have the server open a route for a topic that this side claims to send. Return its id."""
        number, answer = self.describe(topic, transport, qos, kind)
        assert isinstance(answer, Ready)
        return number

    def internal(self, purpose: Purpose, parts: tuple[str, ...], transport: str) -> int:
        """Have the server open an internal route on which this side claims to send. Return its id."""
        name, kind = purpose.route_name(*parts), (purpose.type_name, purpose.type_hash)
        number, answer = self.describe(name, transport, Qos(), kind, purpose=purpose.name, type=purpose.type_name)
        assert isinstance(answer, Ready)
        return number

    def describe(
        self, topic: str, transport: str, qos: Qos, kind: tuple[str, str] = BLOB, **proposed: Any
    ) -> tuple[int, Ready | Refuse]:
        """Propose a route and say what this side sends on it: its id, and what the server says to the latter."""
        number = self.new_route()
        proposed |= {"topic": topic, "remote_topic": topic, "from_client": True, "transport": transport}
        self.say(Propose(route=number, **proposed))
        assert isinstance(self.wait_for(Accept, Refuse), Accept)
        self.say(Describe(number, *kind, qos=qos, sources=(Source((f"rsb_rogue{topic}",)),)))
        answer = self.wait_for(Ready, Refuse)
        assert isinstance(answer, Ready | Refuse)
        return number, answer

    def drain(self) -> None:
        """Read and forget what the server says, until the connection ends."""
        with contextlib.suppress(OSError):
            while self._control.recv(CONTROL_LIMIT):
                pass

    def stream(self, route: int) -> tuple[socket.socket, DataWriter]:
        """Return the stream of small messages, and a writer of a route's frames."""
        assert self.has_streams()
        return self.streams[0], DataWriter(self.keys.route_sealer(route, "client"), route)

    def has_streams(self) -> bool:
        """Whether the server lets both data streams in; they are opened once."""
        return len(self.streams) == 2 or all(self.open_stream(large=large) for large in (False, True))

    def open_stream(self, *, large: bool, port: int = 0, number: int = 0) -> bool:
        """Open a further data stream with the next number, or a given one; return whether the server lets it in."""
        stream = socket.create_connection((self._address[0], port or self._address[1]), timeout=self._timeout)
        self.streams.append(stream)
        data = DataConnection(self.keys, StreamName(number or len(self.streams), port, large))
        stream.sendall(data.start())
        return data.receive_data(stream.recv(4096)) == [Accepted()]

    def takes_little(self) -> None:
        """Have the kernel hold as little as it can of what the server says from now on."""
        self._control.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)

    def begin_chunks(self, stream: socket.socket, writer: DataWriter, size: int = MESSAGE_LIMIT) -> bool:
        """Send the first chunks of a message in whole frames, and return whether the connection still stands."""
        try:
            for _ in range((size - 1) >> 18):
                stream.sendall(write_frame(writer, bytes(1 << 18), 0, MORE))
        except OSError:
            return False
        return not _closed(stream)

    def drain_for(self, seconds: float) -> None:
        """Drop incoming messages for so many seconds. Another thread may send meanwhile."""
        deadline = time.monotonic() + seconds
        with contextlib.suppress(OSError):
            while (left := deadline - time.monotonic()) > 0:
                if select.select([self._control], [], [], left)[0] and not self._control.recv(CONTROL_LIMIT):
                    return

    def probe(self) -> None:
        """Show the server the way for datagrams."""
        for datagram in self.probes.write(Probe(pong=False, opaque=0).pack(), 0, 0, 1400):
            self.udp.send(datagram)

    def datagrams(self, route: int) -> DatagramWriter:
        return DatagramWriter(self.keys.route_sealer(route, "client"), self.keys.link_id, route)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Go without a word."""
        for each in (self._control, self.udp, *self.streams):
            each.close()


def _closed(stream: socket.socket) -> bool:
    """Whether the other side has closed a stream on which it has nothing to say."""
    return bool(select.select([stream], [], [], 0)[0])
