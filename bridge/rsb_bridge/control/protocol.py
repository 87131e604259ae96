"""The protocol of a control socket: commands, frames, messages, and their limits. Sans-IO.

A frame is four bytes of length, big-endian, and a message in MessagePack. The types below and in the model are the
definition: msgspec reads and writes them by their type hints.

`ConsoleHello`, `ConsoleWelcome` and `HelloRefused` keep their fields in every version, so that two versions can tell
each other apart. A release that adds or changes a message, a command or a field of a session raises `VERSION`, and a
bridge refuses consoles of another one, with the words that tell which side to update.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar, Union, cast, get_args

import msgspec

from rsb_bridge import __version__
from rsb_bridge.api import EngineError
from rsb_bridge.installed_features import added
from rsb_bridge.model.commands import Command
from rsb_bridge.model.session import Session
from rsb_bridge.model.snapshot import (
    Event,
    LinkSnapshot,
    RefusedClient,
    RouteSnapshot,
)
from rsb_bridge.model.wording import Wording
from rsb_bridge.wire.framing import FrameReader, pack_frame
from rsb_bridge.wire.protocol_error import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.model.commands import R


VERSION = 1
"""Both sides must have the same."""

TO_BRIDGE_LIMIT = 64 << 10
"""Bytes of a frame to a bridge: the largest is one topic."""
TO_CONSOLE_LIMIT = 16 << 20
"""Bytes of a frame to a console: the largest is the topics of a graph."""
ROUTES_IN_STATE = 50
"""Routes in one `StateChange`; a snapshot of more comes in several, between which the bridge's threads run."""
EVENTS_AT_ONCE = 500
"""Events in one `Events`, at most."""
TO_WATCHER_LIMIT = 64 << 10
"""Bytes of a frame to a console that only watches: the largest is `ConsoleWelcome`."""
SUMMARY_EVERY, SIGN_OF_LIFE_EVERY = 1.0, 5.0
"""s between two that differ at least, and between two at most."""
REQUESTS_WAITING = 32
"""Requests of one console that a bridge answers at the same time."""
CONSOLES = 32
"""Connections to one bridge."""

M = TypeVar("M")


class VersionProblem(Wording):
    """Reasons why a bridge and a console of different versions do not understand each other."""

    BRIDGE_OLDER = (
        "the bridge speaks version {bridge} (rsb-console {bridge_program}), this console {console} "
        "({console_program}): the bridge is older; restart it with the newer rsb-console"
    )
    CONSOLE_OLDER = (
        "the bridge speaks version {bridge} (rsb-console {bridge_program}), this console {console} "
        "({console_program}): this console is older; update it"
    )


class RequestProblem(Wording):
    """Reasons why a command does not reach the bridge, or why its reply is useless."""

    NOT_UNICODE = "this command has bytes that are no Unicode text: write it in UTF-8"
    TOO_LONG = "this command is too long: {size:,} bytes"
    TOO_LATE = "not done: the bridge answers too slowly, or this program stood still; give the command again"


class UnexpectedMessage(Wording):
    """Messages that break this protocol."""

    UNASKED = "an answer without a request"
    ROUTES_NOT_AS_LISTED = "a state that lists a route twice, or has one that it does not list"


class ControlProtocolError(Exception):
    """A message of the other side that breaks this protocol; the error's text says how."""


class _Message(msgspec.Struct, frozen=True, tag_field="is", omit_defaults=True):
    """A message, named by its tag."""


# --- the beginning


class ConsoleHello(_Message, frozen=True, tag="hello"):
    """The first message of a console.

    Attributes:
        program: the version of rsb-console.
        read_only: whether the bridge is to refuse all changes.
    """

    version: int
    program: str
    read_only: bool = False


def hello(*, read_only: bool) -> ConsoleHello:
    """Return the first message of a console of this version; `read_only` asks the bridge to refuse changes."""
    return ConsoleHello(VERSION, __version__, read_only)


class BridgeInfo(msgspec.Struct, frozen=True, omit_defaults=True):
    """The description of a bridge that serves a control socket.

    Attributes:
        address: that it binds or calls.
        started: s since the epoch.
        instance: an id that differs from one engine to the next.
        program: its version of rsb-console.
        file: the absolute path of its session file, or None if there is no file.
        base: the folder that its key files are relative to, absolute.
    """

    name: str
    role: str
    address: str
    pid: int
    started: float
    instance: str
    program: str
    file: str | None = None
    base: str = "/"


class ConsoleWelcome(_Message, frozen=True, tag="welcome"):
    """The answer to `ConsoleHello`.

    Attributes:
        read_only: whether the bridge refuses this console all changes.
        may_take: whether this console may take an arming from its holder without asking.
    """

    bridge: BridgeInfo
    read_only: bool = False
    may_take: bool = True


class HelloRefused(_Message, frozen=True, tag="refused"):
    """The other answer to `ConsoleHello`; the connection closes."""

    reason: str


# --- from a console


def _commands() -> tuple[type[Command[Any]], ...]:
    def tag(command: type[Command[Any]]) -> str:
        return str(command.__struct_config__.tag)

    of_core = tuple(each for each in Command.__subclasses__() if each.__module__ == Command.__module__)
    return (*of_core, *added("commands", name_of=tag, taken=map(tag, of_core)))


if TYPE_CHECKING:
    AnyCommand: TypeAlias = Command[Any]
else:
    AnyCommand = Union[_commands()]  # noqa: UP007 -- there is no other way to write it


class CommandRequest(_Message, frozen=True, tag="request"):
    """A command; answered by a `Reply` or `CommandFailed` of the same id.

    Attributes:
        id: of the console's choosing.
        undo: whether it takes back an earlier command of this console; the bridge's log marks it.
        ticket: the newest one that the console has (`rsb_bridge.control.attached_console.TicketClock`).
    """

    id: int
    command: AnyCommand
    undo: bool = False
    ticket: int = 0


class CommandWithdrawn(_Message, frozen=True, tag="withdrawn"):
    """Ends the work on a command, if that is `cancellable`: nobody waits for it any more. It is answered all the same.

    Attributes:
        id: of the command's request.
    """

    id: int


class PollState(_Message, frozen=True, tag="look"):
    """Asks for the state as soon as it differs from the one sent last; answered once."""


class FollowEvents(_Message, frozen=True, tag="follow"):
    """Asks for the next events, once there are some; and so after each `Events`.

    Attributes:
        after: the number of the last event that the console has.
    """

    after: int


class Watch(_Message, frozen=True, tag="watch"):
    """Asks for a `Summary` now and whenever it is another, for as long as the connection lasts."""


ToBridge: TypeAlias = ConsoleHello | CommandRequest | CommandWithdrawn | PollState | FollowEvents | Watch


# --- from a bridge


class StateChange(_Message, frozen=True, tag="state"):
    """Changes of the engine's state since the last message.

    Fields without an entry here are as in `rsb_bridge.model.snapshot.Snapshot`.

    Attributes:
        routes: new and changed routes.
        more: whether another message of this state follows; only the last one has the fields below.
        keys: of all routes, in order, or None if unchanged.
        session: as in `rsb_bridge.api.EngineApi`, or None if unchanged.
        waits_for_operator: as in `rsb_bridge.api.EngineApi`.
        ticket: for requests of the next moment.
    """

    routes: tuple[msgspec.Raw, ...] = ()
    more: bool = False
    keys: tuple[str, ...] | None = None
    time: float = 0.0
    domain_id: int = 0
    address: str = ""
    running: bool = True
    links: tuple[LinkSnapshot, ...] = ()
    last_event: int = 0
    session: Session | None = None
    waits_for_operator: bool = False
    refused: tuple[RefusedClient, ...] = ()
    unsaved: bool = False
    ticket: int = 0


class Events(_Message, frozen=True, tag="events"):
    """Events in order, numbered as by the engine."""

    events: tuple[Event, ...]


class Summary(_Message, frozen=True, tag="summary"):
    """The engine in a few figures: at most once a second when it has changed, and every 5 s as a sign of life.

    Attributes:
        content: encoded by its maker; this protocol does not look inside.
    """

    content: bytes


class RestartStep(_Message, frozen=True, tag="step"):
    """A step of a restart."""

    id: int
    text: str


class Reply(_Message, frozen=True, tag="reply"):
    """The result of a command.

    Attributes:
        value: plain data, of which `result_of` makes the type that the command names.
        ticket: for requests of the next moment.
    """

    id: int
    value: Any = None
    ticket: int = 0


class CommandFailed(_Message, frozen=True, tag="failed"):
    """A command is not done.

    Attributes:
        invalid: whether the request itself is wrong, as in `rsb_bridge.api.InvalidRequestError`.
        late: whether its ticket was too old; it may be repeated with the new one if its operator still wants it.
        ticket: for requests of the next moment.
    """

    id: int
    reason: str
    invalid: bool = False
    late: bool = False
    ticket: int = 0


class Goodbye(_Message, frozen=True, tag="goodbye"):
    """The bridge ends, or has had enough of this console; the connection closes."""

    reason: str


ToConsole: TypeAlias = (
    ConsoleWelcome | HelloRefused | StateChange | Events | Summary | RestartStep | Reply | CommandFailed | Goodbye
)

_encoder = msgspec.msgpack.Encoder()
_to_bridge: msgspec.msgpack.Decoder[ToBridge] = msgspec.msgpack.Decoder(ToBridge)
_to_console: msgspec.msgpack.Decoder[ToConsole] = msgspec.msgpack.Decoder(ToConsole)
_route = msgspec.msgpack.Decoder(RouteSnapshot)


def encode(message: ToBridge | ToConsole) -> bytes:
    """Return a message as a frame."""
    return pack_frame(_encoder.encode(message))


def result_of(command: Command[R], reply: Reply) -> R:
    """Return the result that a message holds.

    Raises:
        EngineError: it is no result of this command.
    """
    kind = get_args(type(command).__orig_bases__[0])[0]  # type: ignore[attr-defined]
    if kind is type(None):
        return cast("R", None)
    try:
        value = msgspec.convert(reply.value, kind)
    except msgspec.ValidationError:  # a bridge on another machine may answer anything
        raise EngineError("unexpected reply to this command") from None
    try:
        return cast("R", command.checked(value))
    except ValueError as error:
        raise EngineError(str(error)) from None


def encode_route(route: RouteSnapshot) -> msgspec.Raw:
    """Return a route as bytes for a `StateChange`."""
    return msgspec.Raw(_encoder.encode(route))


def decode_route(raw: msgspec.Raw) -> RouteSnapshot:
    """Decode what `encode_route` has returned.

    Raises:
        ControlProtocolError: it is none.
    """
    return _decoded(_route, raw)


class Frames(Generic[M]):
    """Cuts a stream of bytes into messages.

    Args:
        limit: bytes of a frame at most.
    """

    def __init__(self, limit: int, decoder: msgspec.msgpack.Decoder[M]) -> None:
        self._reader = FrameReader(limit)
        self._decoder = decoder

    def feed(self, data: bytes) -> Iterator[M]:
        """Yield the messages that are complete with these bytes.

        Raises:
            ControlProtocolError: a message is too large or invalid.
        """
        try:
            frames = self._reader.feed(data)
        except ProtocolError as error:
            raise ControlProtocolError(str(error)) from None
        for frame in frames:
            yield _decoded(self._decoder, bytes(frame))


def frames_to_bridge() -> Frames[ToBridge]:
    """Return a reader of messages to a bridge."""
    return Frames(TO_BRIDGE_LIMIT, _to_bridge)


def frames_to_console(limit: int = TO_CONSOLE_LIMIT) -> Frames[ToConsole]:
    """Return a reader of messages to a console; `limit` is in bytes of a frame."""
    return Frames(limit, _to_console)


def _decoded(decoder: msgspec.msgpack.Decoder[M], body: bytes | msgspec.Raw) -> M:
    try:
        return decoder.decode(body)
    # Only the first is msgspec's own: text that is no UTF-8 and ten thousand levels raise the others.
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ControlProtocolError(f"an invalid message: {error}") from None


def version_problem(bridge: tuple[int, str], console: tuple[int, str]) -> str:
    """Return a text that names the older side, or an empty string if both have the same version.

    Args:
        bridge: its version of this protocol, and of rsb-console.
        console: its version of this protocol, and of rsb-console.
    """
    if bridge[0] == console[0]:
        return ""
    text = VersionProblem.BRIDGE_OLDER if bridge[0] < console[0] else VersionProblem.CONSOLE_OLDER
    return text(bridge=bridge[0], bridge_program=bridge[1], console=console[0], console_program=console[1])
