"""The command ``echo``: prints a topic's messages as they pass a running bridge."""

from __future__ import annotations

import json
import sys
import time
from concurrent.futures import TimeoutError as LateError
from typing import TYPE_CHECKING

from rsb_bridge.api import EngineError
from rsb_bridge.cdr.decoder import Items
from rsb_bridge.model.text import escape_text
from rsb_console.command.formatting import json_value
from rsb_console.command.shell import print_line, print_lines
from rsb_console.session.reading import KnownTypes, age_text, hex_lines, how_it_came, message_lines, plain, read_message

if TYPE_CHECKING:
    from argparse import Namespace

    from rsb_bridge.api import EngineApi
    from rsb_bridge.cdr.decoder import Value
    from rsb_bridge.model.snapshot import RouteSnapshot
    from rsb_console.session.reading import ReadMessage

_WIDTH = 1 << 20
"""Width in cells, large enough that lines are never wrapped, for `grep` and similar tools."""
_ITEMS = 128  # as `ros2 topic echo`
_ALL = 1 << 20  # elements, and values: a message comes with as many bytes at most
_HEX = 512  # bytes, in 32 lines: a round figure
_NEVER = float("inf")


def echo(engine: EngineApi, route: RouteSnapshot, arguments: Namespace) -> bool:
    """Print messages of a route up to the wanted number; return whether enough came."""
    count = 1 if arguments.once else arguments.count
    deadline = _NEVER if arguments.timeout is None else time.monotonic() + arguments.timeout
    types = KnownTypes(time.monotonic)
    printed = 0
    while count is None or printed < count:
        # With `kept`, each question would bring the same latched message again.
        pending = engine.peek(route.key, kept=printed == 0)
        try:
            # `Future.result` raises an OverflowError for infinity.
            peeked = pending.result(None if deadline == _NEVER else max(0.0, deadline - time.monotonic()))
        except LateError:
            pending.cancel()
            return False
        if peeked is None:  # the bridge gives up after a while, this command does not
            continue
        description, why = types.get(peeked.type_hash) or types.put(peeked.type_hash, *_described(engine, route))
        whole = arguments.full_length or (arguments.json and arguments.arrays)
        items = _ALL if whole else _ITEMS if arguments.arrays else 0
        read = read_message(peeked, description, why, items=items, steps=_ALL)
        if arguments.json:
            print_line(json.dumps(as_json(route, read)))  # in ASCII: a terminal may obey some other characters
        else:
            print_lines(as_text(read, arrays=arguments.arrays))
        # A reader behind a pipe gets each message when it comes, and not after 8 kB.
        sys.stdout.flush()
        printed += 1
    return True


def _described(engine: EngineApi, route: RouteSnapshot) -> tuple[str | None, str]:
    try:
        return engine.describe(route.key).result(), ""
    except EngineError as error:
        return None, str(error)


def as_text(read: ReadMessage, *, arrays: bool) -> str:
    """Format a message as a YAML document, with its origin and delay as a comment."""
    peeked = read.peeked
    lines = [f"# {escape_text(peeked.type_name)}, {how_it_came(peeked)}"]
    if read.age is not None:
        lines.append(f"# {age_text(read.age)}")
    if read.decoded is not None:
        lines += [plain(line) for line in message_lines(read.decoded.message, _WIDTH, arrays=arrays)]
    else:
        lines += [f"# {plain(line)}" for line in hex_lines(peeked.payload, _HEX)]
    if read.problem:
        lines.append(f"# {escape_text(read.problem)}")
    return "\n".join([*lines, "---"])


def as_json(route: RouteSnapshot, read: ReadMessage) -> dict[str, object]:
    """Format a message as one JSON object; NaN and infinities become strings: NaN, Infinity, -Infinity."""
    peeked, age = read.peeked, read.age
    return {
        "topic": route.topic,
        "link": route.link,
        "outgoing": peeked.outgoing,
        "time": peeked.time,
        "type": peeked.type_name,
        "size": peeked.size,
        "kept": peeked.is_kept,
        "link_latency": peeked.latency,
        "stamp": None if age is None else age.stamp,
        "stamp_guessed": age is not None and age.guessed,
        "stamp_latency": None if age is None else age.latency,
        "stamp_clocks": "" if age is None else age.clocks or age.why_none,
        "message": None if read.decoded is None else _json_value(read.decoded.message),
        "problem": read.problem,
        "hex": peeked.payload[:_HEX].hex() if read.decoded is None else None,
    }


def _json_value(value: Value) -> object:
    if isinstance(value, dict):
        return {name: _json_value(inner) for name, inner in value.items()}
    if isinstance(value, Items):
        if len(value.shown) < value.total and not value.shown:
            return f"<{value.element}[{value.total}]>"
        return [_json_value(each) for each in value.shown]
    return json_value(value)
