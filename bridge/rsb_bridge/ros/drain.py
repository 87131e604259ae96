"""Endpoints that a node's thread takes from, each with the sink that what it takes goes to."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rsb_bridge.ros.api import Request, Response, RosError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.api import OnFailure, RequestSink, ResponseSink
    from rsb_bridge.ros.rcl import Incoming
    from rsb_bridge.ros.service_endpoints import Client, Server
    from rsb_bridge.ros.typed_services import TypedClient, TypedServer

BATCH = 64
"""Messages or calls taken from one endpoint before the next has its turn."""

_Taken = TypeVar("_Taken")


class Drain(Generic[_Taken]):
    """Takes from an endpoint until it is closed, or fails.

    Attributes:
        endpoint: which the thread frees.
    """

    def __init__(
        self,
        endpoint: Incoming,
        take: Callable[[int], Sequence[_Taken]],
        sink: Callable[[Sequence[_Taken]], None],
        on_failure: OnFailure | None,
        retire: Callable[[Drain[_Taken]], None],
    ) -> None:
        """Begin.

        Args:
            endpoint: which the thread frees.
            take: takes up to so many from it.
            sink: is given them.
            on_failure: called if it fails.
            retire: has the thread free the endpoint.
        """
        self.endpoint = endpoint
        self._take = take
        self._sink = sink
        self._on_failure = on_failure
        self._retire = retire
        self._delivering = threading.RLock()  # a sink may close its own endpoint
        self._closed = False

    def deliver(self) -> None:
        """Take one batch and hand it on."""
        with self._delivering:
            if self._closed:
                return
            try:
                batch = self._take(BATCH)
            except RosError as error:
                self.close()
                if self._on_failure is not None:
                    self._on_failure(error)
                return
            if batch:
                self._sink(batch)

    def close(self) -> None:
        """Take no more. The sink is not called again after this returns."""
        with self._delivering:
            self._closed = True
        self._retire(self)


class ServerDrain(Drain[Request]):
    """A service that is offered: `rsb_bridge.ros.api.ServiceServer`.

    Attributes:
        service: its name, resolved.
    """

    def __init__(
        self,
        server: Server | TypedServer,
        sink: RequestSink,
        on_failure: OnFailure | None,
        retire: Callable[[Drain[Any]], None],
    ) -> None:
        super().__init__(server, server.take, sink, on_failure, retire)
        self.service = server.name
        self.answer = server.answer


class ClientDrain(Drain[Response]):
    """A service that is called: `rsb_bridge.ros.api.ServiceClient`.

    Attributes:
        service: its name, resolved.
    """

    def __init__(
        self,
        client: Client | TypedClient,
        sink: ResponseSink,
        on_failure: OnFailure | None,
        retire: Callable[[Drain[Any]], None],
    ) -> None:
        super().__init__(client, client.take, sink, on_failure, retire)
        self.service = client.name
        self.call = client.call
        self._client = client

    @property
    def ready(self) -> bool:
        return self._client.ready
