"""The types of a route's lanes: which they are, whether contents are of them, and how the other side's differ."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from rsb_bridge.cdr.checker import MalformedError, TooComplexError
from rsb_bridge.cdr.description import hashes_text, messages_of
from rsb_bridge.model.calls import Refused
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.text import sanitize_text
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.calls.calls_end import MalformedCall
from rsb_bridge.route.message_check import MessageCheck, malformed_text
from rsb_bridge.wire.framing import CALL_LIMIT

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Sequence

    from rsb_bridge.cdr.description import TypeVersion
    from rsb_bridge.route.calls.calls_flow import CallsFlow
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.headers import CallFrame
    from rsb_bridge.wire.records import LaneEntry


class LaneTypes:
    """The types of one route's lanes.

    Attributes:
        names: by lane, as last known.
        messages: the types of their requests, responses and messages, as last known.
        last_malformed: the last malformed request or response in the present opening, or None.
    """

    def __init__(self, flow: CallsFlow) -> None:
        self.names: tuple[str, ...] = ()
        self.messages: tuple[TypeVersion, ...] = ()
        self.last_malformed: MalformedCall | None = None
        self._route = route = flow.route
        self._context = route.context
        self._members, self._failures = flow.members, flow.failures
        self._checks = [MessageCheck(route.context, route.peer.budget.checks) for _ in flow.members]
        self._loaded: tuple[str, ...] = ()  # types by lane, once loading them was tried
        self._loading: tuple[str, ...] = ()

    def know(self, entries: Sequence[LaneEntry]) -> tuple[str, str]:
        """Take the lanes' types.

        Returns:
            The type of all, and its hash; an action and parameters have no hash as a whole.
        """
        self.names = tuple(entry.type for entry in entries)
        self.messages = tuple(each for entry in entries for each in messages_of(entry.type, entry.type_hash))
        types = [member.route_type(entry.type) for member, entry in zip(self._members, entries, strict=True)]
        return next(filter(None, types), ""), entries[0].type_hash if len(entries) == 1 else ""

    def load(self, entries: Sequence[LaneEntry]) -> bool:
        """Return whether these types are loaded; if not, load them on another thread, and let the route advance then.

        The first type that a process loads takes up to a second, because NumPy comes with it. In the loop that would
        end the lease of everything that is armed.
        """
        types = tuple(entry.type for entry in entries)
        if types not in {self._loaded, self._loading}:
            self._loading, ros = types, self._context.ros
            installed = [
                ros.installed_hash if member.is_topic else ros.installed_service_hash for member in self._members
            ]
            loads = [partial(of, each) for of, each in zip(installed, types, strict=True) if each]
            future = self._context.loop.run_in_executor(None, lambda: [load() for load in loads])
            future.add_done_callback(lambda done: self._have_loaded(types, done))
        return types == self._loaded

    def _have_loaded(self, types: tuple[str, ...], done: asyncio.Future[Any]) -> None:
        # Others may have been asked for since.
        if done.cancelled() or types != self._loading:
            return
        if (error := done.exception()) is not None and not isinstance(error, RosError):
            raise error
        self._loaded, self._loading = types, ()
        if self._route.id:
            self._route.advance()

    def set_check(self) -> None:
        """Take over `check_messages` of the session."""
        for check in self._checks:
            check.set()

    def malformed(self, frame: CallFrame, part: str) -> Refused | None:
        """Return the reason why ROS may not get a frame's content, or None if it may.

        Args:
            part: the suffix of the lane's type: ``_Request``, ``_Response`` or nothing.
        """
        peer = self._route.peer.name
        if (size := len(frame.content)) > CALL_LIMIT:
            text = f"{peer} sent {size:,} bytes of {self.names[frame.lane]}, more than {CALL_LIMIT:,}"
            self._failures.say(text, EventCode.ROUTE_TOO_LARGE)
            return Refused.TOO_LARGE
        try:
            self._check(frame.lane, part, frame.content)
        except MalformedError as error:
            type_name = self.names[frame.lane] + part
            self.last_malformed = MalformedCall(type_name, sanitize_text(str(error)))
            self._failures.say(malformed_text(type_name, peer, error), EventCode.ROUTE_MALFORMED)
            return Refused.MALFORMED
        except TooComplexError as error:
            self._failures.say(str(error), EventCode.ROUTE_TOO_COMPLEX)
            return Refused.TOO_COMPLEX
        return None

    def _check(self, lane: int, part: str, content: bytes) -> None:
        """Check a content, if the session wants that, and the type's description is here.

        Raises:
            MalformedError: the content is not of its type.
            TooComplexError: to check it would take too long.
        """
        if not self._context.session.check_messages or lane >= len(self.names):
            return
        type_name, check = self.names[lane] + part, self._checks[lane]
        if check.type_name != type_name:
            check.begin(type_name)
        check.check(content)


class TypeComparison:
    """Finds how the other side's version of a type differs from the installed one.

    The other side may provide ever other types, but is asked about one at a time. The route advances once the fields
    that differ are known, or others have to be compared.
    """

    def __init__(self, route: Route) -> None:
        self._compared: tuple[str, str, str] | None = None  # type, hash there and here, in the present opening
        self._comparing = False
        self._difference = ""  # between the compared types, once the fields are known
        self._route = route

    def difference(self, entry: LaneEntry, installed: str) -> str:
        """Return how a lane's type differs from the installed one: the hashes, until the fields are known."""
        versions = entry.type, entry.type_hash, installed
        if versions != self._compared and not self._comparing:
            self._compared, self._difference, self._comparing = versions, "", True
            here = messages_of(entry.type, installed)
            others = [each for each in messages_of(entry.type, entry.type_hash) if each not in here]
            self._route.peer.compare_types(self._route.id, others, self._compared_types)
        return (self._difference if versions == self._compared else "") or hashes_text(*versions)

    def _compared_types(self, difference: str) -> None:
        self._comparing, self._difference = False, difference
        # In another opening, compare again.
        if self._route.id and (difference or self._compared is None):
            self._route.advance()

    def forget(self) -> None:
        """Forget the comparison, as the opening has ended."""
        self._compared = None
