"""Unpacks a peer's messages, requests and responses, and checks them against their types, before ROS gets them."""

from __future__ import annotations

import threading
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import zstandard

from rsb_bridge.cdr.checker import STEPS, MalformedError, TooComplexError
from rsb_bridge.model.budgets import TokenBucket
from rsb_bridge.model.codes import EventCode
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.wire.framing import CONTENT_LIMIT, HISTORY, MESSAGE_LIMIT
from rsb_bridge.wire.headers import split_history
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable, Sequence

    from rsb_bridge.cdr.checker import Checker
    from rsb_bridge.context import Context
    from rsb_bridge.model.calls import Refused
    from rsb_bridge.ros.ros_interface import Endpoint, Publisher
    from rsb_bridge.wire.framing import Message

# Where these were measured: bench/README.md, *Constants of messages that arrive*.
# Of what a link's compressed messages have more here than on the wire (PROTOCOL.md, 3):
EXPANSION_AT_ONCE, EXPANSION_A_SECOND = 4 * MESSAGE_LIMIT, 256 << 20  # bytes
EXPANSION_A_TURN = 8 << 20  # bytes of that, or one message: everyone else is served between two turns of the loop

# Of long messages:
EXPANDED_ASIDE = 1 << 20  # bytes from which on they are unpacked on another thread
PUBLISHED_ASIDE = 8 << 20  # bytes from which on they are published there, too: copying them holds up the loop
_BEGINS_WITHIN = 0.05  # s after the last look in which the thread has to begin, or it is looked again
BACKLOG_LIMIT = 2 * MESSAGE_LIMIT  # bytes of one route that wait behind one. The sender's window is far smaller

# Of the check:
CHECKED_AT_ONCE = CHECKED_A_SECOND = 2 * STEPS  # lengths in sequences that are read of one link's messages
_EXPLAINED = 4  # a malformed message is charged as this many: it is read twice to name the field
_LOOKS_AGAIN_AFTER = 10.0  # s until the nodes of a topic are asked again for the description of its type

_REMEDY = "send less, or set check_messages: false"
_BACKLOG_FULL = (
    "the other side sends more compressed messages than are unpacked here: send less, or without compression"
)


Look: TypeAlias = "Callable[[], Refused | None]"
"""Returns the reason why a message may not be published, right before it would be, or None."""
Then: TypeAlias = "Callable[[Refused | RosError | None], None]"
"""Called with the reason why a message is not published, or None if DDS has it."""


class _Expansion:
    """A message that is unpacked on another thread.

    Attributes:
        then: called on the loop when it is unpacked.
        wanted: whether its route still waits for it.
        begun: whether it needs no other attempt.
        result: the content, or the reason why it is damaged, or None before it is unpacked.
    """

    def __init__(self, payload: bytes, then: Callable[[], None]) -> None:
        self.payload = payload
        self.then = then
        self.wanted = self.begun = True
        self.result: bytes | zstandard.ZstdError | None = None

    def begins(self) -> bool:
        return self.wanted

    def run(self) -> None:
        """Unpack it, on any thread."""
        try:
            self.result = zstandard.ZstdDecompressor().decompress(self.payload)
        except zstandard.ZstdError as error:
            self.result = error
        # Without a result, the route would wait for ever.
        except MemoryError:
            self.result = zstandard.ZstdError("not enough memory to unpack it")


class LongPublication:
    """A long message that is given to DDS on another thread.

    Args:
        look: asked on the loop, or None if the message is wanted in any case.
        steady: s on a clock that goes on while the machine sleeps.
        then: called on the loop.

    Attributes:
        wanted: whether `then` is to be called.
        begun: whether DDS has it, or is about to.
    """

    def __init__(
        self,
        publisher: Publisher,
        content: bytes,
        look: Look | None,
        steady: Callable[[], float],
        then: Then,
    ) -> None:
        self.wanted = True
        self.begun = False
        self._publisher, self._content = publisher, content
        self._look, self._steady = look, steady
        self._then = then
        self._why: Refused | RosError | None = None
        self._begins_until = float("-inf")
        self._claim = threading.Lock()
        self._over = threading.Event()

    def begins(self) -> bool:
        """Look at it for the last time; return whether it has to be run."""
        if self._look is None:
            self._begins_until = float("inf")
        else:
            self._why, self._begins_until = self._look(), self._steady() + _BEGINS_WITHIN
        return self.wanted and self._why is None

    def run(self) -> None:
        """Publish it, on any thread, unless that begins too late."""
        with self._claim:
            if self._steady() > self._begins_until:
                return
            self.begun = True
        content, self._content = self._content, b""  # it is freed here, and not once the loop comes to that
        try:
            self._publisher.publish(content)
        except RosError as error:
            self._why = error
        finally:
            self._over.set()

    def withdraw(self, *, wait: bool) -> None:
        """Keep DDS from getting it before the next look; if it has begun, `wait` until DDS has it."""
        with self._claim:
            self._begins_until = float("-inf")
        if wait and self.begun:
            self._over.wait()

    def then(self) -> None:
        self._then(self._why)


class ExpansionBudget:
    """Limits on the growth of one link's compressed messages when unpacked here, at once and over time.

    Long messages are unpacked, and published, on another thread, one at a time.
    """

    def __init__(self, now: float) -> None:
        self.over_time = TokenBucket(EXPANSION_AT_ONCE, EXPANSION_A_SECOND, now)
        self._this_turn = 0
        self._waiting: deque[Callable[[], None]] = deque()
        self._aside: deque[_Expansion | LongPublication] = deque()
        self._is_busy = False

    def expand(self, expansion: _Expansion, loop: asyncio.AbstractEventLoop) -> None:
        self._aside.append(expansion)
        self._do_next(loop)

    def publish(self, publication: LongPublication, loop: asyncio.AbstractEventLoop) -> None:
        """Publish a message on another thread, before further ones are unpacked: each takes memory until then."""
        self._aside.appendleft(publication)
        self._do_next(loop)

    def _do_next(self, loop: asyncio.AbstractEventLoop) -> None:
        while self._aside and not self._is_busy:
            work = self._aside.popleft()
            if work.begins():
                self._is_busy = True
                loop.run_in_executor(None, work.run).add_done_callback(partial(self._done, work, loop))
            elif work.wanted:
                work.then()

    def _done(self, work: _Expansion | LongPublication, loop: asyncio.AbstractEventLoop, _: object) -> None:
        if work.wanted and not work.begun:
            self._aside.appendleft(work)
        elif work.wanted:
            work.then()
        self._is_busy = False
        self._do_next(loop)

    def begin(self, size: int, loop: asyncio.AbstractEventLoop) -> bool:
        """Whether a message that grows by `size` bytes may be unpacked at this turn of the loop; if so, it counts."""
        # The first message of a turn may exceed the turn's limit, or it would never be unpacked.
        if self._this_turn and self._this_turn + size > EXPANSION_A_TURN:
            return False
        if not self._this_turn and size > 0:
            loop.call_soon(self._next_turn)
        self._this_turn += max(0, size)
        return True

    def wait(self, work: Callable[[], None]) -> None:
        """Have work done at a later turn, after all that waits already. `begin` was refused at this one."""
        self._waiting.append(work)

    def _next_turn(self) -> None:
        self._this_turn = 0
        # The number is fixed before, because work that cannot go on yet joins the end again.
        for _ in range(len(self._waiting)):
            if self._this_turn >= EXPANSION_A_TURN:
                break
            self._waiting.popleft()()


class ExpandsTooMuchError(Exception):
    """A link's compressed messages grow too much over time."""

    def __init__(self) -> None:
        super().__init__(
            f"this link's compressed messages grow by more than {EXPANSION_A_SECOND:,} bytes a second here: "
            "send less, or without compression"
        )


class Unpacker:
    """Unpacks the compressed messages of one route; later ones wait behind one that is not unpacked yet.

    Args:
        deliver: gets the messages that waited, once the first of them can be unpacked.
        reopen: called if more messages wait than a peer that heeds its window sends.

    Attributes:
        holds: whether further messages have to wait, too.
    """

    def __init__(
        self,
        budget: ExpansionBudget,
        context: Context,
        deliver: Callable[[Sequence[Message]], None],
        reopen: Callable[[EventCode, str], None],
    ) -> None:
        self.holds = False
        self._waiting: list[Message] = []  # oldest first
        self._size = 0  # bytes of these
        self._budget = budget
        self._context = context
        self._deliver = deliver
        self._reopen = reopen
        self._decompressor = zstandard.ZstdDecompressor()
        self._expansion: _Expansion | None = None
        self._publication: LongPublication | None = None
        self._pause: asyncio.TimerHandle | None = None

    def begin(self, message: Message) -> bool:
        """Return whether a message can be unpacked at this turn of the loop. One that will be refused costs no turn.

        If it cannot be, it has to `wait`, and so have the messages behind it.
        """
        payload, _, flags = message
        try:
            content = split_history(payload)[1] if flags & HISTORY else payload
            growth = _growth(content)
        except (ProtocolError, zstandard.ZstdError):
            return True
        if self._expansion is not None:
            if self._expansion.payload == content:
                return self._expansion.result is not None
            self.forget()
        budget, loop = self._budget, self._context.loop
        if growth > budget.over_time.left(self._context.now()):
            return True
        if len(content) + growth > EXPANDED_ASIDE:
            budget.over_time.take(growth, self._context.now())
            self._expansion = _Expansion(content, self.go_on)
            budget.expand(self._expansion, loop)
            return False
        if budget.begin(growth, loop):
            return True
        budget.wait(self.go_on)
        return False

    def wait(self, messages: Iterable[Message]) -> None:
        """Have messages wait until the first of them is unpacked, or the one before them is published."""
        messages = tuple(messages)
        self.holds = True
        self._waiting += messages
        self._size += sum([len(each[0]) for each in messages])
        if self._size > BACKLOG_LIMIT:
            self._reopen(EventCode.ROUTE_EXPANDS_TOO_MUCH, _BACKLOG_FULL)

    def pause(self, messages: Iterable[Message], seconds: float) -> None:
        """Have messages wait so long, or until what they wait for otherwise is done."""
        if not self.holds:
            self._pause = self._context.loop.call_later(seconds, self.go_on)
        self.wait(messages)

    def go_on(self) -> None:
        """Deliver the messages that wait."""
        waiting, self._waiting, self._size = self._waiting, [], 0
        self.holds = False
        if waiting:
            self._deliver(waiting)

    def publish(self, publisher: Publisher, content: bytes, look: Look | None, then: Then) -> None:
        """Publish a long message on another thread; later ones of this route wait until that is done."""

        def published(why: Refused | RosError | None) -> None:
            self._publication = None
            then(why)
            self.go_on()

        self._publication = LongPublication(publisher, content, look, self._context.clock.steady, published)
        self.holds = True
        self._budget.publish(self._publication, self._context.loop)

    def publish_latched(self, publisher: Publisher, content: bytes, look: Look | None, then: Then) -> None:
        """Publish a long message of a latched topic, too. The end of the opening does not withdraw it."""

        def published(why: Refused | RosError | None) -> None:
            then(why)
            self.go_on()

        made = LongPublication(publisher, content, look, self._context.clock.steady, published)
        self._budget.publish(made, self._context.loop)

    def withdraw(self, *, wait: bool) -> bool:
        """Withdraw the long message that is not published yet, and return whether that is too late."""
        if self._publication is None:
            return False
        self._publication.withdraw(wait=wait)
        return self._publication.begun

    def clear(self) -> None:
        """Drop the messages that wait."""
        self._waiting, self._size, self.holds = [], 0, False
        if self._pause is not None:
            self._pause.cancel()
            self._pause = None
        if self._publication is not None:
            self._publication.withdraw(wait=False)
            self._publication.wanted = False
            self._publication = None
        self.forget()

    def forget(self) -> None:
        """Drop what is unpacked on another thread: its message is published no more."""
        if self._expansion is not None:
            self._expansion.wanted = False
            self._expansion = None

    def unpack(self, payload: bytes) -> bytes:
        """Return a message's content.

        Raises:
            zstandard.ZstdError: it is damaged, or too long.
            ExpandsTooMuchError: it is too much by now.
        """
        expansion, self._expansion = self._expansion, None
        # Its budget was taken when it began.
        if expansion is not None and expansion.payload == payload and expansion.result is not None:
            if isinstance(expansion.result, zstandard.ZstdError):
                raise expansion.result
            return expansion.result
        if not self._budget.over_time.take(_growth(payload), self._context.now()):
            raise ExpandsTooMuchError
        return self._decompressor.decompress(payload)


def _growth(payload: bytes) -> int:
    size = zstandard.frame_content_size(payload)
    # A frame without a size (-1) could grow without limit.
    if not 0 <= size <= CONTENT_LIMIT:
        raise zstandard.ZstdError(f"a compressed message claims {size:,} bytes")
    return size - len(payload)


def malformed_text(type_name: str, peer: str, error: MalformedError) -> str:
    """Describe a malformed message for an operator; the texts of one type are as many as its fields."""
    return f"malformed {type_name} from {peer}: {error}: see the node there that sent it"


class MessageCheck:
    """The check of one topic's messages, or of one service's requests or responses."""

    def __init__(self, context: Context, budget: TokenBucket) -> None:
        self.checker: Checker | None = None  # of the type, or None if messages are not checked
        self.type_name = ""  # to check against, or empty
        self._context = context
        self._budget = budget
        self._looks_at = float("-inf")
        self._looking: asyncio.Task[None] | None = None

    def begin(self, type_name: str) -> None:
        """Check messages of a type from now on, if it is described on this side."""
        self.end()
        self.type_name = type_name
        if self._context.session.check_messages and type_name:
            self.checker = self._context.checkers.installed(type_name)

    def end(self) -> None:
        self.checker = None
        self.type_name = ""
        self._looks_at = float("-inf")
        if self._looking is not None:
            self._looking.cancel()
            self._looking = None

    def set(self) -> None:
        """Take over `check_messages` of the session."""
        self.begin(self.type_name)

    def ask_subscribers(self, topic: str, endpoints: Iterable[Endpoint]) -> None:
        """Ask the nodes that subscribe to a topic for the description of a type that is not installed here.

        This may be called often.
        """
        context = self._context
        if self.checker is not None or self._looking is not None or not self.type_name:
            return
        if not context.session.check_messages or context.now() < self._looks_at:
            return
        hashes = [each.type_hash for each in endpoints if each.type_name == self.type_name and each.type_hash]
        if hashes and context.ros.installed_hash(self.type_name) is None:
            self._looks_at = context.now() + _LOOKS_AGAIN_AFTER
            self._looking = context.loop.create_task(self._ask(self.type_name, hashes[0], topic))

    async def _ask(self, type_name: str, type_hash: str, topic: str) -> None:
        try:
            self.checker = await self._context.checkers.find(type_name, type_hash, topic)
        except RosError:
            pass  # the messages stay unchecked until the next look
        finally:
            self._looking = None

    def check(self, payload: bytes) -> None:
        """Check a message.

        Raises:
            MalformedError: it does not fit its type.
            TooComplexError: it has too many lengths, or the link's messages have.
        """
        checker = self.checker
        if checker is None:
            return
        try:
            if not checker.loops:
                checker.check(payload)
                return
            now = self._context.now()
            if min(len(payload) // 4, STEPS) > self._budget.left(now):  # each length takes four bytes
                raise TooComplexError(
                    f"this link's messages have more than {CHECKED_A_SECOND:,} strings and sequences a second"
                )
            steps = checker.check(payload)
        except MalformedError as error:
            now = self._context.now()
            # No more than is left, or `take` would take nothing.
            self._budget.take(min(_EXPLAINED * error.steps, self._budget.left(now)), now)
            raise
        except TooComplexError as error:
            raise TooComplexError(f"{error}, the most that are checked: {_REMEDY}") from None
        if steps:
            self._budget.take(steps, now)
