"""Commands that look into routes: show a message, describe a type, call by hand."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.cdr.decoder import decode
from rsb_bridge.cdr.description import hash_of_text, read_description
from rsb_bridge.config.fields_text import ITEMS, STEPS, read_fields, write_fields
from rsb_bridge.engine.part import EnginePart
from rsb_bridge.link.extension import Denied, LinkError
from rsb_bridge.link.peer_operators import acting_operator, called
from rsb_bridge.model.calls import SEND_GOAL
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import (
    WHOLE_ANSWER,
    Call,
    CallWhole,
    DescribeType,
    Peek,
    Template,
    WholeAnswer,
)
from rsb_bridge.model.limits import REASON_LENGTH
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.model.wording import Wording
from rsb_bridge.route.calls.caller import Caller
from rsb_bridge.route.calls.manual_call import CallError
from rsb_bridge.route.calls.provider import Provider
from rsb_bridge.route.receiver import Receiver
from rsb_bridge.route.sender import Sender
from rsb_bridge.wire.messages import ByHand

if TYPE_CHECKING:
    from rsb_bridge.cdr.decoder import Decoded
    from rsb_bridge.engine.topic_commands import CommandedBridge
    from rsb_bridge.link.link import Link
    from rsb_bridge.model.snapshot import PeekedMessage
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import LaneEntry


CALLS_AT_ONCE = 32
"""Calls by hand that one bridge makes at the same time. A round figure: a script that calls in a loop is refused long
before it takes the places of the nodes' calls (4,096 a link)."""
_GOAL_ID_BYTES = 16


class CalledProblem(Wording):
    """The reason why a program does not get an answer that came."""

    TOO_LONG = (
        "the answer, a {type}, has {size:.1f} MiB, and at most {limit} are given to a program: use a topic for it"
    )


class RouteInspector(EnginePart):
    """Executes commands that look at messages and types, or call by hand."""

    def __init__(self, bridge: CommandedBridge) -> None:
        self._bridge = bridge
        self._context = bridge.context
        self._calls = 0
        self.handlers = {
            Call: self.call,
            CallWhole: self.call_whole,
            DescribeType: self.describe,
            Peek: self.peek,
            Template: self.template,
        }

    async def peek(self, command: Peek) -> PeekedMessage | None:
        _, route = self._bridge.find(command.key)
        if not isinstance(route.half, Sender | Receiver):
            raise LinkError(f"{route.local_topic} has calls, no messages")
        return await self._bridge.peeking.peek(route.half.flow, kept=command.kept)

    async def describe(self, command: DescribeType) -> str:
        link, route = self._bridge.find(command.key)
        return await link.type_questions.describe(route)

    async def template(self, command: Template) -> str:
        half = _callable(self._bridge.find(command.key)[1])
        number = _lane_named(half, command.lane)
        return await asyncio.to_thread(self._defaults, half, number, half.entry(number))

    async def call(self, command: Call) -> str:
        """Call by hand; both sides record the operator."""
        type_name, goal, response = await self._answer(command)
        answer = await asyncio.to_thread(lambda: write_fields(self._decoded(type_name, response)))
        return (f"# goal_id: {goal}\n" if goal else "") + answer

    async def call_whole(self, command: CallWhole) -> WholeAnswer:
        """Call by hand for a program; the console reads the answer, since that may take seconds."""
        type_name, goal, response = await self._answer(command)
        if len(response) > WHOLE_ANSWER:
            size = len(response) / (1 << 20)
            raise LinkError(CalledProblem.TOO_LONG(type=type_name, size=size, limit=WHOLE_ANSWER >> 20))
        return WholeAnswer(response, await asyncio.to_thread(self._description, type_name), goal)

    async def _answer(self, command: Call | CallWhole) -> tuple[str, str, bytes]:
        """Return the type of an answer, the goal's id that was chosen, and the answer."""
        link, route = self._bridge.find(command.key)
        half = _callable(route)
        if self._calls >= CALLS_AT_ONCE:
            raise LinkError(Denied.TOO_MANY_CALLS(limit=CALLS_AT_ONCE))
        self._calls += 1
        try:
            return await self._call(link, half, _lane_named(half, command.lane), command.request)
        finally:
            self._calls -= 1

    async def _call(self, link: Link, half: Caller | Provider, lane: int, request: str) -> tuple[str, str, bytes]:
        entry = half.entry(lane)
        payload, goal = await asyncio.to_thread(self._serialized, half, lane, entry, request)
        line = sanitize_text(" ".join(request.split()))
        self._record(link, half.route, ByHand(route=half.route.id, lane=lane, request=line, who=acting_operator()))
        began, outcome = self._context.now(), "an error of the bridge"
        try:
            response = await half.call_by_hand(lane, payload)
            outcome = f"answered after {self._context.now() - began:.3g} s"
        except CallError as error:
            outcome = f"failed: {error}"
            raise
        except asyncio.CancelledError:
            outcome = "cancelled by its operator"
            raise
        finally:
            outcome = sanitize_text(outcome, REASON_LENGTH)
            self._record(
                link, half.route, ByHand(route=half.route.id, lane=lane, who=acting_operator(), outcome=outcome)
            )
        return f"{entry.type}_Response", goal, response

    def _record(self, link: Link, route: Route, message: ByHand) -> None:
        """Record an operator's call, or its outcome, in the logs of both sides."""
        # 0: it is not open. A call on the providing side needs no link.
        if message.route:
            link.send(message)
        code = EventCode.OPERATOR_CALL_ENDED if message.outcome else EventCode.OPERATOR_CALLED
        what = called(route, message.lane, message.outcome)
        self._bridge.log.add(
            code,
            what,
            topic=route.local_topic,
            link=route.peer.name,
            new=message.outcome or message.request,
        )

    def _serialized(self, half: Caller | Provider, lane: int, entry: LaneEntry, request: str) -> tuple[bytes, str]:
        """Return a request as bytes, and the id of a goal if it is chosen here. Slow: not for the I/O thread."""
        ros, context = self._context.ros, self._context
        installed = ros.installed_service_hash(entry.type)
        # The node would read the bytes as other fields.
        if installed is not None and installed != entry.type_hash:
            raise LinkError(
                f"{entry.type} is installed here in another version than the node has: install that one, and restart "
                "this bridge"
            )
        fields, goal = read_fields(request), ""
        # By default, the ids of all goals are zeros, and a server refuses the second goal of an id.
        if _is_goal(half, lane) and isinstance(fields, dict) and "goal_id" not in fields:
            goal = fields["goal_id"] = context.random.randbytes(_GOAL_ID_BYTES).hex()
        return ros.serialize(f"{entry.type}_Request", fields, context.wall_ns()), goal

    def _defaults(self, half: Caller | Provider, lane: int, entry: LaneEntry) -> str:
        """Return the defaults of a request as YAML, without the id of a goal. Slow: not for the I/O thread."""
        type_name = f"{entry.type}_Request"
        decoded = self._decoded(type_name, self._context.ros.serialize(type_name, {}, self._context.wall_ns()))
        if _is_goal(half, lane):
            decoded.message.pop("goal_id", None)
        return write_fields(decoded)

    def _description(self, type_name: str) -> str:
        text = self._context.ros.installed_description(type_name)
        assert text is not None, "its request was made here"
        return text

    def _decoded(self, type_name: str, payload: bytes) -> Decoded:
        """Decode a message of a type that is installed here. Slow: not for the I/O thread."""
        text = self._description(type_name)
        return decode(read_description(text, hash_of_text(text)), payload, items=ITEMS, steps=STEPS)


def _callable(route: Route) -> Caller | Provider:
    if not isinstance(route.half, Caller | Provider):
        raise LinkError(Denied.NOT_CALLED(topic=route.local_topic))
    return route.half


def _is_goal(half: Caller | Provider, lane: int) -> bool:
    return half.route.spec.kind == "action" and lane == SEND_GOAL


def _lane_named(half: Caller | Provider, name: str) -> int:
    """Return the number of a lane that can be called, by its name."""
    names = {member.name: number for number, member in enumerate(half.flow.members) if not member.is_topic}
    if name in names:
        return names[name]
    shown = ", ".join(filter(None, names))
    raise LinkError(f"{half.route.local_topic} has no {name!r} to call" + (f": choose one of {shown}" if shown else ""))
