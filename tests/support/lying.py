"""A bridge that lies in every field of every answer: it speaks the control socket's protocol, and tells no truth."""

from __future__ import annotations

import contextlib
import math
import os
import socket
import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import msgspec
from tests.console.scripted import CALL_ROUTES, LINK, ROUTES, SESSION

from rsb_bridge.control import protocol
from rsb_bridge.control.protocol import ConsoleWelcome, Events, Reply, StateChange
from rsb_bridge.model.session import Session
from rsb_bridge.model.snapshot import Event, LinkSnapshot, RouteSnapshot
from rsb_bridge.wire.framing import pack_frame

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rsb_bridge.control.protocol import ToBridge

ESCAPES = "\x1b]0;owned\x07\x1b[2J\u202egpj\x9b1m\r\u2066\u200b[red]"


class Lie(NamedTuple):
    """What a bridge says in place of every text and every figure; or what it answers commands with, of any type."""

    text: str
    figure: float = 0.0
    answer: Any = ...


def lies(path: str) -> dict[str, Lie]:
    """Return the kinds of lies; `path` is of a file that nobody may touch."""
    return {
        "escapes": Lie(ESCAPES, math.nan),
        "path": Lie(path, math.inf),
        "way back": Lie(f"../../../../../../../..{path}", -math.inf),
        "lines": Lie("robot1\n2026-01-01 forged\ttab", 1e308),
        "nothing": Lie(""),
        "very long": Lie("x" * 5_000, -1e308),
        "of another type": Lie("robot1", 0.0, {"robot1": [None, 10**18, {"robot1": "robot1"}]}),
    }


def nasty(kind: msgspec.inspect.Type, text: str, figure: float) -> Any:
    """Something of a type in which every text and every figure is as given: what a decoder lets through."""
    inspect = msgspec.inspect
    match kind:
        case inspect.StructType(fields=fields, tag=tag, array_like=True):
            values = [nasty(field.type, text, figure) for field in fields]
            return values if tag is None else [tag, *values]
        case inspect.StructType(fields=fields, tag=tag, tag_field=tag_field):
            tagged = {} if tag is None else {tag_field: tag}
            return tagged | {field.encode_name: nasty(field.type, text, figure) for field in fields}
        case inspect.DataclassType(fields=fields):
            return {field.encode_name: nasty(field.type, text, figure) for field in fields}
        case inspect.VarTupleType(item_type=item) | inspect.ListType(item_type=item):
            return [] if isinstance(item, inspect.RawType) else [nasty(item, text, figure)]
        case inspect.TupleType(item_types=items):
            return [nasty(item, text, figure) for item in items]
        case inspect.DictType(key_type=key, value_type=value):
            return {nasty(key, text, figure): nasty(value, text, figure)}
        case inspect.UnionType(types=types):
            return nasty(
                max(types, key=lambda each: isinstance(each, inspect.StrType | inspect.StructType)), text, figure
            )
        case inspect.EnumType(cls=cls):
            return next(iter(cls)).value
        case inspect.LiteralType(values=values):
            return values[0]
        case inspect.StrType(pattern=pattern):
            return text if pattern is None else ""  # the decoder refuses the text
        case inspect.FloatType():
            return figure
        case inspect.IntType(ge=least):
            return -(10**9) if least is None else least
        case inspect.BytesType():
            return b""
        case inspect.BoolType():
            return True
        case inspect.NoneType():
            return None
        case inspect.AnyType():  # of a feature
            return {text: [text, figure, -(10**9), {text: text}]}
    raise AssertionError(f"a type that no message has had before: {kind}")


def made(kind: Any, lie: Lie) -> Any:
    """Return a lie of a type."""
    said = nasty(msgspec.inspect.type_info(kind), lie.text, lie.figure)
    return msgspec.msgpack.decode(msgspec.msgpack.encode(said), type=kind)


class LyingBridge:
    """Serves a control socket.

    Args:
        path: of the socket; its folder is there.
        uid: the user as whom the kernel sees it. Only root may give another one.
        honest_names: whether it at least says its name and those of its routes and links, so that commands find them.
    """

    def __init__(self, path: Path, lie: Lie, *, uid: int | None = None, honest_names: bool = True) -> None:
        self._lie, self._honest_names = lie, honest_names
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        own = os.geteuid()
        if uid is not None:
            os.chown(path, uid, uid)
            os.seteuid(uid)  # the kernel notes who listens
        try:
            self._listener.listen(16)
        finally:
            os.seteuid(own)
        self._open: set[socket.socket] = set()
        self.heard: list[ToBridge] = []
        self._said = protocol.encode(self._state())  # once: a screen asks often
        self._thread = threading.Thread(target=self._accept, name="lying", daemon=True)
        self._thread.start()

    def close(self) -> None:
        for each in (self._listener, *self._open):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
        self._thread.join(60)
        self._listener.close()

    def __enter__(self) -> LyingBridge:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self._open.add(connection)
                threading.Thread(target=self._serve, args=(connection,), name="lying", daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        frames = protocol.frames_to_bridge()
        with connection, contextlib.suppress(OSError):
            said_at = -math.inf
            while data := connection.recv(1 << 16):
                for message in frames.feed(data):
                    self.heard.append(message)
                    if isinstance(message, protocol.PollState):  # as often as a bridge has news
                        time.sleep(max(0.0, said_at + 0.5 - time.monotonic()))
                        said_at = time.monotonic()
                    for answer in self._answers(message):
                        connection.sendall(answer)
        self._open.discard(connection)

    def _answers(self, message: ToBridge) -> Iterator[bytes]:
        match message:
            case protocol.ConsoleHello():
                said = made(ConsoleWelcome, self._lie)
                if self._honest_names:
                    known = msgspec.structs.replace(said.bridge, name=SESSION.name, role=SESSION.role)
                    said = msgspec.structs.replace(said, bridge=known, read_only=False)
                yield protocol.encode(said)
            case protocol.PollState():
                yield self._said
            case protocol.FollowEvents(after):
                if after <= 0:
                    yield protocol.encode(Events((made(Event, self._lie),)))
            case protocol.CommandRequest():
                yield self._reply(message)
            case protocol.Watch():
                yield protocol.encode(protocol.Summary(self._lie.text.encode()))
            case protocol.CommandWithdrawn():
                pass

    def _reply(self, request: protocol.CommandRequest) -> bytes:
        kind = get_args(type(request.command).__orig_bases__[0])[0]  # type: ignore[attr-defined]
        answer = self._lie.answer
        if answer is ...:
            answer = None if kind is type(None) else nasty(msgspec.inspect.type_info(kind), *self._lie[:2])
        return pack_frame(msgspec.msgpack.encode(Reply(request.id, answer)))

    def _state(self) -> StateChange:
        lie = self._lie
        routes, links = [made(RouteSnapshot, lie)], [made(LinkSnapshot, lie)]
        if self._honest_names:
            for each in (*ROUTES, *CALL_ROUTES):
                names = {name: getattr(each, name) for name in ("key", "link", "spec", "topic", "calls", "state")}
                routes.append(replace(routes[0], **names))
            links.append(replace(links[0], name=LINK.name, state=LINK.state))
        session = msgspec.structs.replace(made(Session, lie), features={})
        said: StateChange = msgspec.structs.replace(
            made(StateChange, lie), more=False, session=session, links=tuple(links)
        )
        keys = tuple(each.key for each in routes)
        return msgspec.structs.replace(said, routes=tuple(map(protocol.encode_route, routes)), keys=keys)
