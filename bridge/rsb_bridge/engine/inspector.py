"""What routes carry, for operators: they look at its messages, read what its types are, and call it by hand."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import hash_of_text, read_description
from rsb_bridge.config.fields_text import ITEMS, STEPS, read_fields, write_fields
from rsb_bridge.link.errors import Denied, LinkError
from rsb_bridge.link.peer_operators import acting_operator, called
from rsb_bridge.model.calls import SEND_GOAL
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import REASON_LENGTH
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.route.calls.calls_route import CallsRoute
from rsb_bridge.route.calls.manual_call import CallError
from rsb_bridge.route.peeking import PeekError, Peeking
from rsb_bridge.route.topic_route import TopicRoute
from rsb_bridge.wire.messages import ByHand

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

    from rsb_bridge.cdr.decoder import Decoded
    from rsb_bridge.context import Context
    from rsb_bridge.engine.topic_commands import Recorder
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.snapshot import PeekedMessage
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import LaneEntry


CALLS_AT_ONCE = 32
"""Calls by hand that one bridge makes."""
_GOAL_ID_BYTES = 16


class RouteInspector:
    """Commands of one bridge, on its event loop; what is wrong with one is an `EngineError`.

    Args:
        context: what every part of the engine shares.
        find: gives a route and its link by the route's key.
        command: what a command runs in: turns its errors into `EngineError`, and has the snapshot show its effect.
        did: records what an operator has done.
    """

    def __init__(
        self,
        context: Context,
        find: Callable[[str], tuple[Link, Route]],
        command: Callable[[], AbstractContextManager[None]],
        did: Recorder,
    ) -> None:
        self._context = context
        self._find = find
        self._command = command
        self._did = did
        self._peeking = Peeking(context)
        self._calls = 0

    async def peek(self, key: str, *, kept: bool) -> PeekedMessage | None:
        """Wait for a topic's next message; nothing that this does changes the snapshot."""
        try:
            _, route = self._find(key)
            if not isinstance(route, TopicRoute):
                raise EngineError(f"{route.local_topic} is no topic: it has calls, and no messages to look at")
            return await self._peeking.peek(route, kept=kept)
        except (LinkError, PeekError) as error:
            raise EngineError(str(error)) from None

    async def describe(self, key: str) -> str:
        """The text of the description of a route's type."""
        try:
            link, route = self._find(key)
            return await link.type_questions.describe(route, linked=link.linked)
        except LinkError as error:
            raise EngineError(str(error)) from None

    async def template(self, key: str, lane: str) -> str:
        """The fields of a request with their defaults."""
        with self._command():
            route = _callable(self._find(key)[1])
            number = _lane_named(route, lane)
            try:
                return await asyncio.to_thread(self._defaults, route, number, route.entry(number))
            except CallError as error:
                raise LinkError(str(error)) from None

    async def call(self, key: str, request: str, lane: str) -> str:
        """Call what a route provides, by hand; both sides record who did."""
        with self._command():
            link, found = self._find(key)
            route = _callable(found)
            if self._calls >= CALLS_AT_ONCE:
                raise LinkError(Denied.TOO_MANY_CALLS(limit=CALLS_AT_ONCE))
            self._calls += 1
            try:
                return await self._call(link, route, _lane_named(route, lane), request)
            except CallError as error:
                raise LinkError(str(error)) from None
            finally:
                self._calls -= 1

    async def _call(self, link: Link, route: CallsRoute, lane: int, request: str) -> str:
        entry = route.entry(lane)
        payload, note = await asyncio.to_thread(self._serialized, route, lane, entry, request)
        line = sanitize_text(" ".join(request.split()))
        self._record(link, route, ByHand(route=route.id, lane=lane, request=line, who=acting_operator()))
        began, outcome = self._context.now(), "an error of the bridge"
        try:
            response = await route.call_by_hand(lane, payload)
            outcome = f"answered after {self._context.now() - began:.3g} s"
        except CallError as error:
            outcome = f"failed: {error}"
            raise
        except asyncio.CancelledError:
            outcome = "given up by whoever made it"
            raise
        finally:
            outcome = sanitize_text(outcome, REASON_LENGTH)
            self._record(link, route, ByHand(route=route.id, lane=lane, who=acting_operator(), outcome=outcome))
        return note + await asyncio.to_thread(self._text_of, f"{entry.type}_Response", response)

    def _record(self, link: Link, route: CallsRoute, message: ByHand) -> None:
        """Have both sides' logs say what an operator here calls, or what became of it."""
        if message.route:
            link.send(message)
        code = EventCode.OPERATOR_CALL_ENDED if message.outcome else EventCode.OPERATOR_CALLED
        what = called(route, message.lane, message.outcome)
        self._did(code, what, topic=route.local_topic, link=route.peer.name, new=message.outcome or message.request)

    def _serialized(self, route: CallsRoute, lane: int, entry: LaneEntry, request: str) -> tuple[bytes, str]:
        """A request as bytes, and what its operator should know of it; on a thread that may take some time."""
        ros, context = self._context.ros, self._context
        installed = ros.installed_service_hash(entry.type)
        if installed is not None and installed != entry.type_hash:
            raise LinkError(f"{entry.type} is installed here in another version than the node has: install that one")
        fields, note = read_fields(request), ""
        if _is_goal(route, lane) and isinstance(fields, dict) and "goal_id" not in fields:
            goal = fields["goal_id"] = context.random.randbytes(_GOAL_ID_BYTES).hex()
            note = f"# goal_id: {goal}\n"
        return ros.serialize(f"{entry.type}_Request", fields, context.wall_ns()), note

    def _defaults(self, route: CallsRoute, lane: int, entry: LaneEntry) -> str:
        """What a request has where nothing is written, as YAML, likewise; but for the id that a goal gets anyway."""
        type_name = f"{entry.type}_Request"
        decoded = self._decoded(type_name, self._context.ros.serialize(type_name, {}, self._context.wall_ns()))
        if _is_goal(route, lane):
            decoded.message.pop("goal_id", None)
        return write_fields(decoded)

    def _text_of(self, type_name: str, payload: bytes) -> str:
        """A message as YAML, likewise."""
        return write_fields(self._decoded(type_name, payload))

    def _decoded(self, type_name: str, payload: bytes) -> Decoded:
        text = self._context.ros.installed_description(type_name)
        assert text is not None, "its request was made here"
        return decode(read_description(text, hash_of_text(text)), payload, items=ITEMS, steps=STEPS)


def _callable(route: Route) -> CallsRoute:
    if not isinstance(route, CallsRoute):
        raise LinkError(f"{route.local_topic} is a topic, which nobody can call")
    return route


def _is_goal(route: CallsRoute, lane: int) -> bool:
    return route.spec.kind == "action" and lane == SEND_GOAL


def _lane_named(route: CallsRoute, name: str) -> int:
    """A lane's number, by its name among those that can be called."""
    names = {member.name: number for number, member in enumerate(route.members) if not member.is_topic}
    if name in names:
        return names[name]
    shown = ", ".join(filter(None, names))
    raise LinkError(f"{route.local_topic} has no {name!r} to call" + (f": say which of {shown}" if shown else ""))
