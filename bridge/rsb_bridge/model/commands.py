"""Commands to an engine, their effects, and the operator and the console of the one that is being executed.

Consoles make commands, and `rsb_bridge.engine.bridge.Bridge.do` executes them. A command names the type of its result
as the parameter of `Command`, and declares the right that it needs. The control socket sends commands as they are
(`rsb_bridge.control.protocol.CommandRequest`), so tags and fields are part of its protocol.
"""

from __future__ import annotations

import contextlib
import enum
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import msgspec

from rsb_bridge.model.by_hand import OLD_AFTER, Held
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import PeekedMessage, Reloaded, State, TopicInfo

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator
    from contextlib import AbstractContextManager

R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)


class Right(enum.Enum):
    """The rights that commands need."""

    LOOK = enum.auto()
    """Every console has it."""
    MEASURE = enum.auto()
    """Every console has it, unless its operator has read-only access: a measurement loads the link."""
    CHANGE = enum.auto()
    """A console lacks it if its operator has read-only access, or if the console is attached read-only."""
    TAKE = enum.auto()
    """To take an arming from its holder at once. A console with `CHANGE` has it; an operator over a network also needs
    `may: take`."""


class Effect(enum.Flag):
    """The effect of a command, or of a Yes, on robots and files: from it follows what must not come late."""

    HARMLESS = 0
    """It stops something, or changes what can be changed back."""
    MOVES = enum.auto()
    """A robot may move, or messages may cross that do not cross now."""
    LOSES = enum.auto()
    """Something ends, is removed or is overwritten."""


class Command(msgspec.Struct, Generic[R_co], frozen=True, tag_field="is", omit_defaults=True):
    """A command, named by its tag."""

    right: ClassVar[Right] = Right.CHANGE  # needed to give the command
    always: ClassVar[Effect] = Effect.HARMLESS
    """The effect for any value of the fields. Each command that needs a right to change states it."""
    one_at_a_time: ClassVar[bool] = False
    """Whether the command waits for the earlier ones of its kind, because it changes the session."""
    refreshes: ClassVar[bool] = True  # whether the next snapshot is made at once, to show the effect
    cancellable: ClassVar[bool] = False
    """Whether the engine stops working on the command when nobody waits for the result any more."""
    is_of_links: ClassVar[bool] = False
    """Whether it concerns all links, or the one that its field `link` names. An operator of one robot of a server has
    it concern that robot."""

    @property
    def effect(self) -> Effect:
        return self.always

    def checked(self, result: Any) -> Any:
        """Return the command's result, which may come from a bridge that is not trusted, safe for terminals.

        Raises:
            ValueError: it is no result of this command.
        """
        return result

    @property
    def expires(self) -> bool:
        """Whether an attached console's command is void if it comes late, because it may move a robot."""
        return Effect.MOVES in self.effect

    @property
    def life(self) -> float:
        """Seconds for which it may be on its way, if it expires."""
        return OLD_AFTER


class AddTopic(Command[str], frozen=True, tag="add"):
    """Bridge one more topic, or follow one more pattern. The result is the key of the route or the pattern."""

    one_at_a_time = True
    is_of_links = True
    topic: Topic
    """The new entry. A server also takes its own name of the topic, with the client's name before it
    (`Session.use_name`)."""
    link: str = ""  # on a server, the name of the client

    @property
    def effect(self) -> Effect:
        return Effect.HARMLESS if self.topic.paused else Effect.MOVES


class EditTopic(Command[str], frozen=True, tag="edit"):
    """Replace a route's topic, or a pattern. The result is the new key; if the command fails, the old route stays."""

    one_at_a_time = True
    key: str  # of the route or the pattern
    topic: Topic
    drop_arm: bool = False
    """Whether an operator has agreed to end the demand to be armed. Without that, a change from ``arm: true`` to false
    is refused, and any other change keeps the demand."""
    seen: Topic | None = None
    """The entry that the operator has seen, or None. The command is refused if it is another one by now."""

    @property
    def effect(self) -> Effect:
        was_paused = self.seen is None or self.seen.paused
        return Effect.MOVES if self.drop_arm or (was_paused and not self.topic.paused) else Effect.HARMLESS


class RemoveTopic(Command[str], frozen=True, tag="remove"):
    """Stop bridging a topic on both sides, or following a pattern.

    It returns the lines of this side's session that still demand that the name be armed, or an empty string.
    """

    one_at_a_time = True
    key: str  # of the route or the pattern
    drop_arm: bool = False  # whether an operator has agreed to end the demand that the name be armed

    @property
    def effect(self) -> Effect:
        return Effect.LOSES | Effect.MOVES if self.drop_arm else Effect.LOSES  # other lines may bridge the name, too


class PauseTopics(Command[None], frozen=True, tag="pause"):
    """Stop or resume carrying the messages of a topic, or of all topics that a pattern matches, on both sides."""

    one_at_a_time = True
    key: str
    paused: bool

    @property
    def effect(self) -> Effect:
        return Effect.HARMLESS if self.paused else Effect.MOVES


class Acknowledge(Command[None], frozen=True, tag="acknowledge"):
    """Acknowledge a fault until its state or its cause changes, or take that back."""

    refreshes = False  # it asks for all that is new, and then only adds its mark
    always = Effect.HARMLESS
    key: str = ""  # of a route or a pattern. A route that is down with its link has the link's fault
    acknowledged: bool = True  # whether the fault is acknowledged from now on
    link: str = ""  # the name of a link, instead of a key
    seen: tuple[State, str] | None = None
    """The state and the cause that the operator has seen, or None. Another fault is not acknowledged."""


class ArmTopic(Command[None], frozen=True, tag="arm"):
    """Arm a topic for the console that gives the command; done once both sides hold it for armed.

    The console has to keep the topic armed (`KeepArmed`). Only its messages by hand pass from then on.
    """

    always = Effect.MOVES
    key: str
    shared: bool = False
    """Whether messages by hand of that operator's other consoles pass, too: the commands of a shell are one console
    each."""


class AskHolder(Command[None], frozen=True, tag="ask_holder"):
    """Ask the holder of an armed topic for it, and arm it for the console that gives the command, after a disarm.

    The holder has `rsb_bridge.model.by_hand.ASKED_FOR` for an answer; without one it goes over. Meanwhile, the console
    has to give signs of life (`KeepArmed`). A topic that nobody holds is armed at once.
    """

    always = Effect.MOVES
    cancellable = True
    key: str
    shared: bool = False  # as of `ArmTopic`


class TakeArming(Command[None], frozen=True, tag="take_arming"):
    """Arm a topic for the console that gives the command, after a disarm if another one holds it."""

    always = Effect.MOVES
    right = Right.TAKE
    key: str
    shared: bool = False  # as of `ArmTopic`


class AnswerAsker(Command[None], frozen=True, tag="answer_asker"):
    """Answer an operator who asks the console that gives the command for its arming of a topic."""

    always = Effect.MOVES
    key: str
    gives: bool  # whether the topic goes over
    who: str = ""  # the operator who asks, as the holder has seen, or empty. An answer to another one is refused


class DisarmTopic(Command[None], frozen=True, tag="disarm"):
    """Disarm a topic, even if another operator armed it; done once no earlier message can be published."""

    always = Effect.HARMLESS
    key: str
    own: bool = False  # whether to do so only if the console that gives the command holds it


class KeepArmed(Command[Held], frozen=True, tag="keep_armed"):
    """Keep armed all topics that this console has armed, and open what it asks for; due at least every 2 s.

    A topic disarms if its console is silent for 5 s, or if its operator presses no key within its deadman time.
    """

    right = Right.LOOK
    refreshes = False
    pressed: bool  # whether the operator has pressed a key since the last command, so that deadman times start again


class ReleaseArmed(Command[None], frozen=True, tag="release_armed"):
    """Disarm all topics that this console has armed, because the console ends."""

    right = Right.LOOK


class AddClient(Command[None], frozen=True, tag="add_client"):
    """Accept one more client, on a server; its key file is read where the bridge runs."""

    one_at_a_time = True
    always = Effect.MOVES
    client: Client


class ChangeClient(Command[None], frozen=True, tag="change_client"):
    """Replace the entry of a server's client of that name; its key file is read again."""

    one_at_a_time = True
    always = Effect.HARMLESS
    client: Client


class RemoveClient(Command[None], frozen=True, tag="remove_client"):
    """Accept a server's client no longer, and end its link."""

    one_at_a_time = True
    always = Effect.LOSES
    name: str


class Retry(Command[None], frozen=True, tag="retry"):
    """Connect now instead of later, and open refused topics again."""

    always = Effect.MOVES  # also what somebody has shut down
    is_of_links = True
    link: str = ""


class ShutDownLinks(Command[None], frozen=True, tag="shut_down"):
    """Close the sockets on both sides until an operator restarts, as the shutdown topic does."""

    always = Effect.HARMLESS


class Restart(Command[None], frozen=True, tag="restart"):
    """Close the links on both sides and open them again."""

    always = Effect.MOVES | Effect.LOSES


class Reload(Command[Reloaded], frozen=True, tag="reload"):
    """Read the session file again, and change what differs; links and topics that do not differ go on.

    Unsaved changes of operators give way to the file. A file with mistakes changes nothing.
    """

    one_at_a_time = True
    dry_run: bool = False  # whether to report only, and change nothing
    drop_arm: bool = False
    """Whether an operator has agreed to end the demands to arm that the file does not make any more."""
    seen: str = ""  # `Reloaded.digest` of the changes to which an operator has agreed, or empty. Others are refused

    @property
    def effect(self) -> Effect:
        return Effect.HARMLESS if self.dry_run else Effect.MOVES | Effect.LOSES


class Save(Command[None], frozen=True, tag="save"):
    """Write the session to its file, whose comments stay. A file that somebody else has changed is not overwritten."""

    one_at_a_time = True
    always = Effect.HARMLESS


class Topics(Command[tuple[TopicInfo, ...]], frozen=True, tag="topics"):
    """List the topics, services, actions and nodes that can be bridged."""

    right = Right.LOOK
    refreshes = False
    link: str | None = None  # whose peer's graph to list, or None for the graph of this side


class Peek(Command[PeekedMessage | None], frozen=True, tag="peek"):
    """Wait for a topic's next message. The result is None if none has passed within some seconds: ask again.

    A topic shows a message every half second at most. Messages take no extra step while nobody peeks.
    """

    right = Right.LOOK
    refreshes = False
    cancellable = True
    key: str
    kept: bool = False  # whether to take the message of a latched topic that a late joiner gets


class DescribeType(Command[str], frozen=True, tag="describe"):
    """Find the description of a topic's type (`rsb_bridge.cdr.description`) on either side."""

    right = Right.LOOK
    refreshes = False
    cancellable = True
    key: str


class Template(Command[str], frozen=True, tag="template"):
    """Write a request for `Call`, with the defaults of all fields, as YAML."""

    right = Right.LOOK
    refreshes = False
    cancellable = True
    key: str
    lane: str = ""


class Call(Command[str], frozen=True, tag="call"):
    """Call by hand, from either side. The types have to be installed where the bridge runs.

    The result is the response, as YAML.
    """

    always = Effect.MOVES
    cancellable = True
    key: str  # of a route that is no topic's
    request: str  # the fields as YAML, or an empty string for the defaults
    lane: str = ""  # one of the route's services (`RouteSnapshot.lanes`)


WHOLE_ANSWER = 15 << 20
"""Bytes of an answer that a console gets whole: with its description, it fits into a frame of the control socket."""


class WholeAnswer(msgspec.Struct, frozen=True):
    """The answer of a service as it came.

    Attributes:
        payload: serialized, with its encapsulation header.
        description: of its type (`rsb_bridge.cdr.description`).
        goal: id of the goal that the bridge has chosen, 32 hex digits, or an empty string.
    """

    payload: bytes
    description: str
    goal: str = ""


class CallWhole(Command[WholeAnswer], frozen=True, tag="call_whole"):
    """Call as `Call` does, for a program, which gets the whole answer."""

    always = Effect.MOVES
    cancellable = True
    key: str
    request: str
    lane: str = ""


class Stop(Command[None], frozen=True, tag="stop"):
    """End the bridge's process, as SIGTERM does.

    The engine only records the command; the control server ends the process.
    """

    always = Effect.LOSES


@dataclass(frozen=True, slots=True)
class ActingOperator:
    """The person who gives commands. As text, the name and the place: ``anna on pts/3``."""

    account: str
    """The identity that the kernel or a key proves, or an empty string: the same account, the same person."""
    name: str  # for people; several of them may have the same
    place: str = ""  # of the person's console, in words

    def __str__(self) -> str:
        return f"{self.name} {self.place}".strip()


OWN_CONSOLE = "the bridge's own console"
_OWN = ActingOperator("", OWN_CONSOLE)
_operator = ContextVar("operator", default=_OWN)
_undo = ContextVar("undo", default=False)
_console: ContextVar[Hashable] = ContextVar("console", default="own")


def operator() -> str:
    """Return the operator of the present command, in words.

    A task has the operator of the code that started it, on another thread, too.
    """
    return str(_operator.get())


def account() -> str:
    """Return the account of the present command's operator, or an empty string if nothing proves who it is."""
    return _operator.get().account


@contextlib.contextmanager
def _set(variable: ContextVar[R], value: R) -> Iterator[None]:
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


def acting(who: ActingOperator | str) -> AbstractContextManager[None]:
    """Give commands in the name of an operator.

    Args:
        who: the operator, or in words what gives them if it is no person: ``SIGHUP``.
    """
    return _set(_operator, ActingOperator("", who) if isinstance(who, str) else who)


def is_undo() -> bool:
    """Whether the present command undoes an earlier one of the same operator."""
    return _undo.get()


def undoing(undo: bool = True) -> AbstractContextManager[None]:
    """Mark the commands given inside as undoing earlier commands."""
    return _set(_undo, undo)


def console() -> Hashable:
    """Return the identity of the present command's console, ``own`` for that of the bridge's own process.

    A task has the console of the code that started it, on another thread, too.
    """
    return _console.get()


def on_console(which: Hashable) -> AbstractContextManager[None]:
    return _set(_console, which)
