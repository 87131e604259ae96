"""The option and the key that keep a stretch, and the rules of its settings."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from tests.console.driving import NARROW, WIDE, on_main, shown
from tests.console.scripted import ScriptedEngine, answers, refused
from tests.support.wording import says

from rsb_bridge.config.validation import validate
from rsb_extras.disk_ring import DiskRingFeature
from rsb_extras.disk_ring.keep_command import KeptText
from rsb_extras.disk_ring.keep_stretch import NOTE_LENGTH, KeepStretch
from rsb_extras.disk_ring.ring_codes import RingProblem
from rsb_extras.disk_ring.ring_rules import RingRuleText
from rsb_extras.disk_ring.tests.scripted_answers import KEEPING
from rsb_extras.recording import RecordLimits
from rsb_extras.recording.record_rules import RecordText
from rsb_extras.recording.tests.recordings import session

if TYPE_CHECKING:
    from tests.support.control import Machine
    from textual.pilot import Pilot

    from rsb_bridge.model.wording import Wording
    from rsb_console.app import ConsoleApp


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[KeepStretch]:
    known: Any = answers()
    found: list[KeepStretch] = []

    def reply(command: KeepStretch) -> Any:
        found.append(command)
        return refused(RingProblem.OFF()) if command.note == "refused" else KEEPING

    monkeypatch.setitem(known, KeepStretch, reply)
    return found


def test_option_keeps_a_stretch(ran: Any, machine: Machine, asked: list[KeepStretch]) -> None:
    machine.have(ScriptedEngine())
    done = ran("record", "--keep", "it fell")
    assert (done.code, asked) == (0, [KeepStretch("it fell")])
    assert says(done.out, KeptText.KEPT, before=60, after=30, path=KEEPING.path)
    found = json.loads(ran("record", "--keep", "", "--json").out)
    assert (found["path"], found["before"], found["after"]) == (KEEPING.path, 60.0, 30.0)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--keep", "a", "--seconds", "3"), KeptText.ALONE),
        (("--keep", "a", "--output", "x.mcap"), KeptText.ALONE),
        (("list", "--keep", "a"), KeptText.ALONE),
        (("--keep", "a", "--from", "-30"), KeptText.ALONE),
        (("--keep", "a" * (NOTE_LENGTH + 1)), KeptText.TOO_LONG),
    ],
)
def test_wrong_usage(options: tuple[str, ...], text: Wording, ran: Any, machine: Machine) -> None:
    machine.have(ScriptedEngine())
    done = ran("record", *options)
    assert (done.code, says(done.err, text)) == (2, True)


def test_refusal_names_the_remedy(ran: Any, machine: Machine, asked: list[KeepStretch]) -> None:
    machine.have(ScriptedEngine())
    done = ran("record", "--keep", "refused")
    assert (done.code, says(done.err, RingProblem.OFF)) == (1, True)
    assert "record: {disk: 2}" in done.err


@on_main(WIDE, NARROW)
async def test_key_asks_for_a_note(app: ConsoleApp, pilot: Pilot[None], asked: list[KeepStretch]) -> None:
    await pilot.press("E")
    await shown(pilot, "Keep what was before")
    await pilot.press(*"fell", "enter")
    await shown(pilot, "/recordings/")
    (command,) = asked
    assert command.note == "fell"
    assert command.ago > 0


@on_main()
async def test_key_may_be_taken_back(app: ConsoleApp, pilot: Pilot[None], asked: list[KeepStretch]) -> None:
    await pilot.press("E")
    await shown(pilot, "Keep what was before")
    await pilot.press("escape", "E")
    await shown(pilot, "Keep what was before")
    await pilot.press(*"refused", "enter")
    await shown(pilot, "no ring on disk")
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("limits", "where", "text"),
    [
        (RecordLimits(disk=-1.0), "record.disk", RecordText.OUT_OF_RANGE),
        (RecordLimits(disk=2.0, disk_seconds=1.0), "record.disk_seconds", RecordText.OUT_OF_RANGE),
        (RecordLimits(disk=2.0, free=float("nan")), "record.free", RecordText.OUT_OF_RANGE),
        (RecordLimits(disk=2.0, after=601.0), "record.after", RecordText.OUT_OF_RANGE),
        (RecordLimits(disk=2.0, kept=0.0), "record.kept", RecordText.OUT_OF_RANGE),
        (RecordLimits(before=10.0), "record.before", RingRuleText.NEEDS_DISK),
        (RecordLimits(also=("/chat",)), "record.also", RingRuleText.NEEDS_DISK),
        (RecordLimits(disk=2.0, also=("chat",)), "record.also", RingRuleText.NOT_A_NAME),
        (RecordLimits(disk=2.0, also=("/a",) * 65), "record.also", RingRuleText.TOO_MANY),
    ],
)
def test_bounds_have_a_range(limits: RecordLimits, where: str, text: Wording) -> None:
    ((location, message),) = [(each.location, each.message) for each in validate(session(limits))]
    assert location == where
    assert says(message, text)


def test_check_says_what_it_does_and_costs() -> None:
    feature, limits = DiskRingFeature(), RecordLimits(disk=2.0, also=("/arm/**",))
    lines = [*feature.effects(session(limits))]
    assert lines == [
        "record: 2 GB of what passes on disk; kept are 60 s before and 30 s after: fault, link, disarm, E",
        "record: and of this side's domain: /arm/**",
    ]
    assert [*feature.advice(session(limits), None)] == [("record.also", RingRuleText.ALSO())]
    assert not [*feature.effects(session(True))]
    assert not [*feature.advice(session(RecordLimits(disk=2.0)), None)]
