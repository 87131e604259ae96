"""A bridge's files on disk: history and events, damaged by a disk or written by another version."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import msgspec
import zstandard
from tests.fuzz.editing import edit_json_lines, edit_msgpack
from tests.fuzz.parser import Parser
from tests.fuzz.scratch import scratch_folder

from rsb_bridge.model.snapshot import Event, Level, State
from rsb_bridge.model.text import is_clean
from rsb_extras.history import history_files
from rsb_extras.history.bridge_files import Files
from rsb_extras.history.history_data import HistoryReport
from rsb_extras.history.history_files import HistoryFileError
from rsb_extras.history.tests.hand_clock import EPOCH
from rsb_extras.history.tests.world import World
from rsb_extras.history.timeline import Timeline

_NOW = EPOCH + 100


@cache
def _files() -> Files:
    return Files(scratch_folder(), "robot1")


def _check_report(report: HistoryReport) -> None:
    encoded = msgspec.json.encode(report)
    assert len(encoded) <= 4 << 20
    assert msgspec.json.decode(encoded, type=HistoryReport) == report  # JSON turns infinity and NaN into null


def _read_history(pack: Callable[[bytes], bytes], data: bytes) -> None:
    """Read a history as a command does, and as the next process of the bridge does."""
    files = _files()
    files.history.write_bytes(pack(data))
    files.events.unlink(missing_ok=True)
    with contextlib.suppress(HistoryFileError):
        _check_report(history_files.report(files, _NOW, 3600.0))
    try:
        saved = history_files.read_history(files.history)
        timeline = Timeline.restore(saved, "robot1", "client")
    except (HistoryFileError, ValueError):
        return
    again = timeline.save(saved.time)
    assert msgspec.msgpack.encode(
        Timeline.restore(again, "robot1", "client").save(saved.time)
    ) == msgspec.msgpack.encode(again)


def _read_events(data: bytes) -> None:
    files = _files()
    files.events.write_bytes(data)
    events = list(history_files.read_events(files.events, _NOW))
    assert len(events) <= data.count(b"\n") + 1
    timeline = Timeline("robot1", "client")
    timeline.go_on(events)
    _check_report(timeline.report(_NOW + 60, 3600.0, running=False))
    for event in events:
        if not (event.code and event.text and is_clean(event.code)):
            continue  # this program writes none
        line = history_files.encode_event(event)
        files.events.write_bytes(line)
        (again,) = history_files.read_events(files.events, _NOW)
        assert history_files.encode_event(again) == line


def _saved() -> bytes:
    world = World("/scan", "/map")
    world.go(70)
    world.put("/scan", State.STALE, "no message for 2 s")
    world.go(5)
    return msgspec.msgpack.encode(world.recorder.save())


_EVENTS = (
    Event(1, _NOW + 1, Level.INFO, "link.up", "up"),
    Event(2, _NOW + 9, Level.WARNING, "route.fault", "no message", topic="/scan", state="stale", since=_NOW),
)
_BOMB = b"\x28\xb5\x2f\xfd\xe0" + (1 << 40).to_bytes(8, "little") + b"\1\0\0"
"""Claims to hold a TiB."""

_CORPORA = Path(__file__).with_name("corpus")
PARSERS = (
    Parser("history_content", partial(_read_history, zstandard.compress), (_saved(),), edit_msgpack, _CORPORA),
    Parser(
        "history_file", partial(_read_history, bytes), (zstandard.compress(_saved()[:60]), b"", _BOMB), corpora=_CORPORA
    ),
    Parser(
        "event_file", _read_events, (b"".join(map(history_files.encode_event, _EVENTS)),), edit_json_lines, _CORPORA
    ),
)
