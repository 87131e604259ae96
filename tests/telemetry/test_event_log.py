"""Events are one clean line each, for all quoted texts: a log prints them as they are."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import msgspec
import pytest
from tests.support.bridge import happened, linked
from tests.support.rogue import Rogue
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.config.keys import read_key
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level
from rsb_bridge.telemetry.event_log import EVENT_LENGTH, EventLog
from rsb_bridge.wire.protocol_error import Broken
from rsb_console.command.formatting import StatusLines, json_status, text_event
from rsb_console.session.exports import export_log

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.bridge import Bridge

FORGED = "\x1b[2J\x1b]0;title\x07\n2026-01-01 00:00:00 ERROR   engine   forged \u202e\u200b\u2066"


@pytest.mark.parametrize(
    "text", [FORGED, FORGED * 10_000, "a path that is no UTF-8: \udcff"], ids=["forged", "long", "no utf-8"]
)
def test_text_of_an_event(text: str) -> None:
    log = EventLog(Clock())
    log.add(Level.ERROR, EventCode.ENGINE_ERROR, text, link=text, topic=text, who=text, old=text, new=text, cause=text)
    log.append(Event(0, 0.0, Level.INFO, EventCode.LINK_LOST, text, link=text))
    for event in log.after(0):
        assert event.text.isprintable()
        assert len(event.text) <= EVENT_LENGTH
        for each in (event.link, event.topic, event.who, event.old, event.new, event.cause):
            assert each.isprintable()
            assert len(each) <= 500


def test_path_outside_utf_8_keeps_its_bytes() -> None:
    log = EventLog(Clock())
    log.add(Level.INFO, EventCode.OPERATOR_RELOADED, "r\udcff.yaml is read again")
    assert log.after(0)[0].text == r"r\udcff.yaml is read again"


@pytest.mark.parametrize("field", ["message", "code"])
def test_a_peer_forges_no_line(field: str, bridge: Bridge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A message whose decoding fails is quoted in why the link was lost: in the log, the status and exports."""
    server = bridge.server()
    message = {"message": "refuse", "route": 1, "code": "denied", "reason": ""} | {field: FORGED + "x" * 500_000}
    with Rogue(bridge.port, read_key(bridge.folder / bridge.key_file).secret) as rogue:
        eventually(lambda: linked(server))
        rogue.say_raw(msgspec.msgpack.encode(message))
        eventually(lambda: happened(server, EventCode.LINK_LOST))
    (lost,) = [event for event in server.events() if event.code == EventCode.LINK_LOST]
    monkeypatch.chdir(tmp_path)
    lines = [text_event(lost), StatusLines().text(server.snapshot()), json_status(server.snapshot())]
    events = server.events()
    exported = export_log(events).read_text(encoding="utf-8").splitlines()
    assert len(exported) == len(events)
    for line in [*lines, *exported]:
        assert line.isprintable()
        assert len(line) < 3000
    assert says(lost.text, Broken.INVALID_CONTROL_MESSAGE)


def test_waiting_ends_with_event_or_time() -> None:
    log, ends = EventLog(Clock()), threading.Event()
    found: list[list[Event]] = []
    waiting = threading.Thread(target=lambda: found.append(log.wait(0, 60.0, ends.is_set)))
    waiting.start()
    log.wake()
    waiting.join(0.1)
    assert waiting.is_alive()
    ends.set()
    log.wake()
    waiting.join(30.0)
    assert found == [[]]
    log.add(Level.INFO, EventCode.LINK_UP, "up")
    assert [event.text for event in log.wait(0, 60.0)] == ["up"]
