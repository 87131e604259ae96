"""A latched topic on the receiving side: late joiners here get what late joiners on the sending side get.

Every publisher of the sending side has a publisher of its own here, which keeps as many of its messages as it keeps
itself. Between two publishers DDS has no order, so a history that still grows has one, as deep as any. A DDS
publisher's depth cannot change: once the history's own is found, another publisher takes the messages from then on, and
the deep one stays until all that it has are too old. Meanwhile late joiners get more than is kept on the sending side,
in the order of chance. Nothing is published again, as present subscribers would hear it twice, unless the topic is to
belong to another mirrored node: then all hear it from that, as they hear a node that is started again.

A present subscriber misses none of them: it may discover a publisher here seconds late, and until it has, DDS may
overwrite the publisher's messages or close it. So messages wait meanwhile, and a publisher is closed once its messages
are acknowledged.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from rsb_bridge.model.calls import Refused
from rsb_bridge.model.limits import LATCHED_DEPTH
from rsb_bridge.ros.ros_interface import Publisher, RosError, RosProblem
from rsb_bridge.route.message_check import PUBLISHED_ASIDE
from rsb_bridge.route.peer_budget import KEPT_LIMIT

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable, Iterator, Mapping

    from rsb_bridge.route.message_check import Look, Then
    from rsb_bridge.wire.framing import Budget
    from rsb_bridge.wire.headers import HistoryHeader

# Bytes that are counted in the link's budget.
PUBLISHER_COST = 1 << 20  # with each publisher, which bounds their number: DDS needs about 170 kB
MESSAGE_COST = 256  # for what DDS keeps with each message: an estimate

# Of what subscribers here have discovered and received. Times in s; bench/README.md, *Latched topics*.
_DISCOVERED_WITHIN = 10.0  # for a new publisher: a busy machine needs several. Others wait for a stopped subscriber
_GIVEN_UP_AFTER = 30.0  # for the last messages of a closing publisher: DDS forgets a stopped subscriber after 20
_ACKNOWLEDGED_WITHIN = 0.5  # until another publisher may follow: a stopped subscriber acknowledges nothing
_ASKED = 4  # publishers asked for their subscribers: the oldest, which have been discovered by all
_LOOKS_AGAIN_AFTER = 0.02  # until DDS is asked again who has discovered what: a round figure

# Of messages that waited: so many at once, and the next ones after so many s, which an rclpy subscriber can take. All
# at once they overran one that keeps 500. What is more than `_MANY` goes at once: they come to an end at any rate.
_AT_ONCE, _GOES_ON_AFTER, _MANY = 100, 0.005, 5000

_GONE_AFTER = 10.0  # s without a word of a publisher, which a sender that has just started may not know yet


Dropped: TypeAlias = Callable[[Refused | RosError], None]
"""Called with the reason for which a message is not published after all."""
Aside: TypeAlias = "Callable[[Publisher, bytes, Look | None, Then], None]"
"""Has a long message published on another thread (`message_check.Unpacker.publish_latched`)."""


class LatchedFullError(Exception):
    """The link's latched topics would keep too much."""

    def __init__(self) -> None:
        super().__init__(
            f"this link's latched topics keep more than {KEPT_LIMIT:,} bytes ({PUBLISHER_COST:,} are counted with "
            "each publisher): give some a smaller depth"
        )


class _Kept(NamedTuple):
    """A message that DDS keeps for late joiners here."""

    number: int
    memory: int  # bytes that it takes
    content: bytes  # or empty, if it is not to be published again


@dataclass(slots=True, eq=False)
class _OutputHistory:
    """A publisher here, and what it keeps. Times are in s."""

    publisher: Publisher
    depth: int
    made_at: float
    used_at: float  # when it was made, last published, or was retired
    kept: deque[_Kept] = field(default_factory=deque)  # oldest first
    waiting: int = 0  # its messages that DDS does not have yet
    published: int = 0  # the others
    discovered: bool = False  # all subscribers have had a message of it, or had time to

    @property
    def full(self) -> bool:
        return len(self.kept) >= self.depth


class _Message(NamedTuple):
    """A message, and the output that is to publish it."""

    output: _OutputHistory
    content: bytes
    look: Look | None  # asked right before DDS gets it
    dropped: Dropped  # called if it is not published


@dataclass(slots=True)
class _History:
    """The history of one publisher of the sending side."""

    seen_at: float  # s, when it was last seen
    newest: int = 0  # number of its newest message that came here
    depth: int = 0  # that the sender has found, in this opening or an earlier one, or 0
    was_present: bool = False  # in this opening, so that its absence means its end
    outputs: list[_OutputHistory] = field(default_factory=list)  # the publishers here that have its messages
    # Until an output is discovered, or has delivered what it published before.
    waiting: deque[_Message] = field(default_factory=deque)
    last: _OutputHistory | None = None  # the output that published last


def _ignored(_: object) -> None:
    pass


class LatchedTopic:
    """The histories of one topic, for as long as its type and QoS stay. It belongs to the I/O loop.

    Attributes:
        is_busy: whether DDS is about to get a long message, which later ones must not overtake.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        advertise: Callable[[int], Publisher],
        budget: Budget,
        depth: int,
        aside: Aside | None = None,
        *,
        repeats: bool = False,
    ) -> None:
        """Make a first publisher, so that the topic is there before its first message.

        Args:
            advertise: makes a publisher with a depth; may raise RosError.
            depth: initial depth of a history, until its own has been found.
            aside: publishes long messages, which are published here otherwise.
            repeats: whether messages are kept here, too, so that `move` can publish them once more.

        Raises:
            RosError: the publisher cannot be created.
            LatchedFullError: the link's latched topics keep too much.
        """
        self._loop = loop
        self._advertise = advertise
        self._budget = budget
        self._aside = aside
        self._repeats = repeats
        self.is_busy = False
        self._histories: dict[bytes, _History] = {}
        self._retired: list[_OutputHistory] = []
        self._present: Mapping[bytes, int] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._first_depth = depth
        self._spare: _OutputHistory | None = None  # which `_output` looks for
        self._spare = self._output(depth)

    @property
    def subscriber_count(self) -> int:
        """Subscriptions of other nodes that match now."""
        return max((output.publisher.subscriber_count for output in islice(self._outputs(), _ASKED)), default=0)

    @property
    def refuses(self) -> bool:
        """Whether DDS has refused a subscription for a policy that the graph does not show."""
        return any(output.publisher.refuses for output in islice(self._outputs(), _ASKED))

    def newest(self) -> dict[bytes, int]:
        """Return the number of the newest message of each publisher of the sending side."""
        return {publisher: history.newest for publisher, history in self._histories.items() if history.newest}

    @property
    def has_kept(self) -> bool:
        return any(history.newest for history in self._histories.values())

    @property
    def needs_sender(self) -> bool:
        """Whether only the sender can repeat what late joiners get."""
        if self._repeats:
            return self.is_busy or any(history.waiting for history in self._histories.values())
        return self.has_kept

    def move(self) -> bool:
        """Have publishers that belong to another node, and publish there what is kept, unless that needs the sender.

        Raises:
            RosError, LatchedFullError: there can be none.
        """
        if self.needs_sender:
            return False
        moved: dict[_OutputHistory, _OutputHistory] = {}
        try:
            for former in self._outputs():
                moved[former] = self._new_output(former.depth)
                # Once more until they are published: `_next_waiting` gives that back.
                self._take(sum(each.memory + len(each.content) for each in former.kept))
                moved[former].kept.extend(former.kept)
        except (RosError, LatchedFullError):
            for output in moved.values():
                self._budget.give(sum(len(each.content) for each in output.kept))
                self._close(output)
            raise
        if self._spare is not None:
            self._spare = moved[self._spare]
        for history in self._histories.values():
            history.outputs = [moved[output] for output in history.outputs]
            for output in history.outputs:
                contents = [each.content for each in output.kept if each.content]
                output.waiting = len(contents)
                history.waiting.extend(_Message(output, content, None, _ignored) for content in contents)
        self._retire(moved)
        self._look_again()
        return True

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for history in self._histories.values():
            while history.waiting:
                self._next_waiting(history).dropped(RosError(RosProblem.CLOSED()))
        for output in (*self._outputs(), *self._retired):
            self._close(output)
        self._spare = None
        self._retired.clear()
        self._histories.clear()

    # --- publishers of the sending side

    def opened(self) -> None:
        """Begin a new opening; the sender may not have discovered its publishers yet."""
        for history in self._histories.values():
            history.seen_at, history.was_present = self._loop.time(), False

    def present(self, publishers: Mapping[bytes, int]) -> None:
        """Take the sender's present publishers, and the depth of each or 0. Messages beyond it are kept no longer."""
        now = self._loop.time()
        self._present = publishers
        for publisher, depth in publishers.items():
            if (history := self._histories.get(publisher)) is not None:
                history.seen_at, history.was_present = now, True
                history.depth = depth or history.depth
                if depth:
                    self._drop_older(history, history.newest - depth)

    def tick(self) -> None:
        """Drop the histories of publishers that are gone, and outputs that have delivered; called once a second.

        Raises:
            RosError: no publisher can be created, and there is no history any more that has one.
            LatchedFullError: so does the link's limit forbid one.
        """
        now = self._loop.time()
        # First, so that the topic keeps a publisher until there is the spare one.
        retired, self._retired = self._retired, []
        for output in retired:
            if output.waiting or not (output.publisher.acknowledged or now - output.used_at >= _GIVEN_UP_AFTER):
                self._retired.append(output)
            else:
                self._close(output)
        for publisher, history in tuple(self._histories.items()):
            if publisher in self._present:
                history.seen_at, history.was_present = now, True
            elif (history.was_present or now - history.seen_at > _GONE_AFTER) and not history.waiting:
                del self._histories[publisher]
                self._retire(history.outputs)
        if not self._histories:
            self._spare = self._spare or self._output(self._first_depth)
        elif self._spare is not None and now - self._spare.used_at > _DISCOVERED_WITHIN:
            self._retire([self._spare])
            self._spare = None

    # --- messages

    def publish(
        self,
        header: HistoryHeader,
        content: bytes,
        look: Look | None = None,
        dropped: Dropped = _ignored,
    ) -> bool:
        """Publish a message, now or as soon as all present subscribers will have it, after the messages before it.

        Args:
            look: asked right before DDS gets it, or None.
            dropped: called if it was new, but is not published.

        Returns:
            Whether it was new; one that was published before is left out.

        Raises:
            RosError: there can be no publisher for it.
            LatchedFullError: it would be too much to keep.
        """
        now = self._loop.time()
        history = self._histories.get(header.publisher) or _History(now)
        # It was sent again, or a newer one has overtaken it, as datagrams may: late joiners get the newest last.
        if header.number and header.number <= history.newest:
            return False
        history.seen_at = now
        number = header.number or history.newest + 1
        # A depth that the sender has found since also holds for messages that it sent before.
        depth = self._present.get(header.publisher, 0) or history.depth or min(header.depth, LATCHED_DEPTH)
        output = self._output_for(history, depth)
        waits = self.is_busy or bool(history.waiting) or not self._is_next(history, output, now)
        # Only now, as a history without outputs would have the spare publisher closed, the topic's last one.
        self._histories[header.publisher] = history
        # The message that gives way leaves its memory, so that a full publisher costs no more than before.
        evicted = output.kept[0].memory if output.full else 0
        # DDS uses it again, and never makes it smaller.
        memory = max(len(content) * (2 if self._repeats else 1) + MESSAGE_COST, evicted)
        self._take(memory - evicted + (len(content) if waits else 0))
        if output.full:
            output.kept.popleft()
        output.kept.append(_Kept(number, memory, content if self._repeats else b""))
        history.newest = number
        message = _Message(output, content, look, dropped)
        if waits:
            output.waiting += 1
            history.waiting.append(message)
            self._look_again()
        else:
            self._publish(history, message)
        self._drop_older(history, number - depth)
        return True

    def _output_for(self, history: _History, depth: int) -> _OutputHistory:
        """Return the output for the next message of a history."""
        if not history.outputs or history.outputs[-1].depth != depth:
            history.outputs.append(self._output(depth))
        return history.outputs[-1]

    def _drop_older(self, history: _History, number: int) -> None:
        """Drop the outputs of a history all of whose messages have that number or an older one."""
        kept = [output for output in history.outputs if not output.kept or output.kept[-1].number > number]
        if len(kept) < len(history.outputs):
            self._retire(output for output in history.outputs if output not in kept)
            history.outputs = kept

    # --- outputs

    def _outputs(self) -> Iterator[_OutputHistory]:
        if self._spare is not None:
            yield self._spare
        for history in self._histories.values():
            yield from history.outputs

    def _output(self, depth: int) -> _OutputHistory:
        """Return an output of that depth, the spare one if it fits."""
        spare = self._spare
        if spare is not None and spare.depth == depth:
            self._spare = None
            return spare
        return self._new_output(depth)

    def _new_output(self, depth: int) -> _OutputHistory:
        self._take(PUBLISHER_COST)
        now = self._loop.time()
        try:
            return _OutputHistory(self._advertise(depth), depth, now, now)
        except RosError:
            self._budget.give(PUBLISHER_COST)
            raise

    def _take(self, size: int) -> None:
        """Count more memory, for which retired outputs give way."""
        while not self._budget.take(size):
            delivered = next((output for output in self._retired if not output.waiting), None)
            if delivered is None:
                raise LatchedFullError
            self._retired.remove(delivered)
            self._close(delivered)

    def _retire(self, outputs: Iterable[_OutputHistory]) -> None:
        """Close outputs later: their last messages may wait, or be on their way to a subscriber."""
        for output in outputs:
            output.used_at = self._loop.time()
            self._retired.append(output)

    def _close(self, output: _OutputHistory) -> None:
        output.publisher.close()
        self._budget.give(PUBLISHER_COST + sum(each.memory for each in output.kept))
        output.kept.clear()

    def _publish(self, history: _History, message: _Message) -> None:
        output, content, look, _ = message
        if len(content) > PUBLISHED_ASIDE and self._aside is not None:
            self.is_busy = True
            output.waiting += 1
            self._aside(output.publisher, content, look, partial(self._published, history, message))
            return
        why: Refused | RosError | None = None if look is None else look()
        if why is None:
            history.last, output.used_at = output, self._loop.time()
            output.published += 1
            try:
                output.publisher.publish(content)
            except RosError as error:
                why = error
        if why is not None:
            self._refused(message, why)

    def _published(self, history: _History, message: _Message, why: Refused | RosError | None) -> None:
        self.is_busy = False
        output = message.output
        output.waiting -= 1
        if why is None:
            history.last, output.used_at = output, self._loop.time()
            output.published += 1
        else:
            self._refused(message, why)

    @staticmethod
    def _refused(message: _Message, why: Refused | RosError) -> None:
        """Tell why a message was not published, which it is not to be by another publisher either."""
        kept = message.output.kept
        for place, each in enumerate(kept):
            if each.content is message.content:
                kept[place] = each._replace(content=b"")
        message.dropped(why)

    def _is_next(self, history: _History, output: _OutputHistory, now: float) -> bool:
        """Whether the next message may be published: all subscribers will hear it, after other outputs' messages."""
        last = history.last
        if last is None or (last is output and (output.discovered or self._overwrites_nothing(output, now))):
            return True
        # DDS here knows the subscribers of a new publisher at once, but they may not know it yet. They would miss what
        # it overwrites meanwhile, and hear its messages after those of the next publisher that they discover.
        acknowledged = last.publisher.acknowledged
        limit = _ACKNOWLEDGED_WITHIN if last.discovered else _DISCOVERED_WITHIN
        if not acknowledged and now - last.used_at < limit:
            return False
        last.discovered = True
        return True

    @staticmethod
    def _overwrites_nothing(output: _OutputHistory, now: float) -> bool:
        """Whether a new output has room for a message, and not so many that they overrun who discovers it."""
        few = output.published < _AT_ONCE or now - output.made_at >= _ACKNOWLEDGED_WITHIN
        return few and output.published < output.depth

    def _look_again(self, after: float = _LOOKS_AGAIN_AFTER) -> None:
        if self._timer is None:
            self._timer = self._loop.call_later(after, self._publish_waiting)

    def _publish_waiting(self) -> None:
        self._timer = None
        now = self._loop.time()
        left = max(_AT_ONCE, sum(len(history.waiting) for history in self._histories.values()) - _MANY)
        for history in self._histories.values():
            while (
                left and history.waiting and not self.is_busy and self._is_next(history, history.waiting[0].output, now)
            ):
                left -= 1
                self._publish(history, self._next_waiting(history))
            if history.waiting:
                self._look_again(_LOOKS_AGAIN_AFTER if left else _GOES_ON_AFTER)

    def _next_waiting(self, history: _History) -> _Message:
        message = history.waiting.popleft()
        message.output.waiting -= 1
        self._budget.give(len(message.content))
        return message
