"""A stand-in of a container: its three services over DDS, whose types are described here, and no components.

No installation here has composition_interfaces, and no container runs. What it takes for a component is a name.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from tests.support.participants import KnownNode

from rsb_extras.node_control.cdr_fields import FieldReader, FieldWriter
from rsb_extras.node_control.component_messages import LIST, LIST_TYPE, LOAD, LOAD_TYPE, UNLOAD, UNLOAD_TYPE
from rsb_extras.node_control.parameter_messages import take_value
from rsb_extras.node_control.tests.container_types import service_hash

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.ros_interface import Request, ServiceServer

NAME = "/nav2_container"


class Asked(NamedTuple):
    """A request to load.

    Attributes:
        texts: package, plugin, name and namespace.
    """

    texts: tuple[str, ...]
    remaps: list[str]
    parameters: dict[str, object]
    extra: dict[str, object]


class StandInContainer:
    """The container.

    Attributes:
        loaded: full names by numbers.
        asked: the requests to load.
        refused: the reason with which it refuses both, or empty.
        holds: whether it does not answer requests to load.
    """

    def __init__(self, domain_id: int) -> None:
        self.loaded = {1: "/planner_server"}
        self.asked: list[Asked] = []
        self.refused, self.holds = "", False
        self._held: list[Callable[[], None]] = []
        self._node = KnownNode(domain_id, "container")
        self._node.start()
        self._servers: dict[str, ServiceServer] = {}
        for service, kind, answer in (
            (LIST, LIST_TYPE, self._list), (LOAD, LOAD_TYPE, self._load), (UNLOAD, UNLOAD_TYPE, self._unload),
        ):  # fmt: skip
            self._serve(service, kind, answer)

    def _serve(self, service: str, kind: str, answer: Callable[[FieldReader], bytes]) -> None:
        def take(requests: Sequence[Request]) -> None:
            for each in requests:
                payload, caller = answer(FieldReader(each.payload)), each.caller
                if service == LOAD and self.holds:
                    self._held.append(partial(server.answer, caller, payload))
                else:
                    server.answer(caller, payload)

        server = self._node.serve(NAME + service, kind, service_hash(kind), take)
        self._servers[service] = server

    def go(self) -> None:
        """Answer what is held."""
        for each in self._held:
            each()

    def _list(self, _: FieldReader) -> bytes:
        writer = FieldWriter().number("I", len(self.loaded))
        for name in self.loaded.values():
            writer.text(name)
        writer.number("I", len(self.loaded))
        for number in self.loaded:
            writer.number("Q", number)
        return writer.message

    def _load(self, request: FieldReader) -> bytes:
        texts = tuple(request.text() for _ in range(4))
        request.number("B")
        remaps = [request.text() for _ in range(request.count(5, 99))]
        parameters, extra = (
            {request.text(): take_value(request).plain() for _ in range(request.count(5, 99))} for _ in range(2)
        )
        self.asked.append(Asked(texts, remaps, parameters, extra))
        _, plugin, name, namespace = texts
        full = f"{namespace}/{name or plugin.rpartition('::')[2].lower()}"
        number = max(self.loaded, default=0) + 1
        if not self.refused:
            self.loaded[number] = full
        return self._answer().text("" if self.refused else full).number("Q", 0 if self.refused else number).message

    def _unload(self, request: FieldReader) -> bytes:
        number = int(request.number("Q"))
        if not self.refused:
            del self.loaded[number]
        return self._answer().message

    def _answer(self) -> FieldWriter:
        return FieldWriter().number("?", not self.refused).text(self.refused)

    def close(self) -> None:
        self._node.stop()
