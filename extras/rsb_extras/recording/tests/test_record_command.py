"""The command and the key: what they say of a recording, and what is refused."""

from __future__ import annotations

import json
import os
import stat
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from msgspec.structs import replace
from tests.console.driving import NARROW, WIDE, on_main, shown
from tests.console.scripted import ScriptedEngine, answers, refused
from tests.support.other_user import only_root, theirs
from tests.support.wording import says

from rsb_bridge.api import EngineError
from rsb_bridge.config.validation import validate
from rsb_console.notation.formats import byte_count
from rsb_extras.pictures.tests.view_screen_helpers import comes, looking, viewed
from rsb_extras.recording import RecordingFeature, RecordLimits, record_limits
from rsb_extras.recording.keep_last import LARGEST, KeepLast
from rsb_extras.recording.keeping import KeepProblem
from rsb_extras.recording.mcap_file import McapText
from rsb_extras.recording.record_command import RecordedText, record
from rsb_extras.recording.record_rules import RecordText
from rsb_extras.recording.tests.recordings import session
from rsb_extras.recording.tests.scripted_answers import KEPT

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.control import Machine
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp
    from rsb_extras.recording.keep_last import KeptRecording


@pytest.fixture
def answer(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Have the bridge answer with a recording, or refuse one."""
    known: Any = answers()
    asked: list[KeepLast] = []

    def have(kept: KeptRecording | str) -> list[KeepLast]:
        def reply(command: KeepLast) -> Any:
            asked.append(command)
            return refused(kept) if isinstance(kept, str) else kept

        monkeypatch.setitem(known, KeepLast, reply)
        return asked

    return have


def test_command_says_where_it_is(ran: Any, machine: Machine, answer: Any) -> None:
    machine.have(ScriptedEngine())
    asked = answer(KEPT)
    done = ran("record", "--seconds", "10")
    assert (done.code, asked) == (0, [KeepLast(10.0)])
    assert says(done.out, RecordedText.WRITTEN, messages=9876, topics=12, size=byte_count(KEPT.size), path=KEPT.path)
    answer(replace(KEPT, host="elsewhere", undescribed=("/odd",), too_large=3))
    done = ran("record")
    assert asked[-1] == KeepLast(None)
    assert says(done.out, RecordedText.WRITTEN)  # the kernel knows better than the bridge
    assert says(done.out, RecordedText.UNDESCRIBED, topics="/odd")
    assert says(done.out, RecordedText.TOO_LARGE, count=3)


def test_json_has_all_of_it(ran: Any, machine: Machine, answer: Any) -> None:
    machine.have(ScriptedEngine())
    answer(KEPT)
    found = json.loads(ran("record", "--json").out)
    assert (found["ok"], found["path"], found["messages"], found["size"]) == (True, KEPT.path, 9_876, 8_400_000)


@pytest.fixture
def recording(folder: Path) -> Path:
    """A file in the bridge's folder."""
    folder.mkdir(parents=True)
    path = folder / "kept.mcap"
    path.write_bytes(b"recording")
    return path


def test_output_moves_file_and_root_copies_it(
    ran: Any, machine: Machine, answer: Any, tmp_path: Path, recording: Path
) -> None:
    machine.have(ScriptedEngine())
    target = tmp_path / "mine.mcap"
    answer(replace(KEPT, path=str(recording), host="any"))
    done = ran("record", "--output", str(target))
    assert (done.code, target.read_bytes(), recording.exists()) == (0, b"recording", os.geteuid() == 0)
    assert says(done.out, RecordedText.WRITTEN, path=target)
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    recording.write_bytes(b"another")
    done = ran("record", "--output", str(target))
    assert (done.code, target.read_bytes(), recording.read_bytes()) == (1, b"recording", b"another")
    assert says(done.err, RecordedText.NOT_MOVED, target=target, path=recording)


def _in_another_folder(recording: Path) -> Path:
    return recording.rename(recording.parents[1] / "kept.mcap")


def _by_a_way_back(recording: Path) -> Path:
    return recording.parent / ".." / _in_another_folder(recording).name


def _symbolic_link(recording: Path) -> Path:
    link = recording.with_name("link.mcap")
    link.symlink_to(_in_another_folder(recording))
    return link


def _hard_link(recording: Path) -> Path:
    recording.with_name("link.mcap").hardlink_to(recording)
    return recording


def _fifo(recording: Path) -> Path:
    recording.unlink()
    os.mkfifo(recording)
    return recording


def _folder_that_is_a_link(recording: Path) -> Path:
    recording.parent.rename(other := recording.parents[1] / "other")
    recording.parent.symlink_to(other)
    return recording


def _of_another_user(recording: Path) -> Path:
    return theirs(recording)


def _too_large(recording: Path) -> Path:
    os.truncate(recording, LARGEST + 1)
    return recording


@pytest.mark.parametrize(
    "name",
    [
        _in_another_folder,
        _by_a_way_back,
        _symbolic_link,
        _hard_link,
        _fifo,
        _folder_that_is_a_link,
        pytest.param(_of_another_user, marks=only_root),
        _too_large,
        lambda path: path.parent,
        lambda path: path.parent / "..",
        lambda _: Path(),
    ],
)
def test_output_moves_nothing_but_recordings(
    name: Callable[[Path], Path], ran: Any, machine: Machine, answer: Any, tmp_path: Path, recording: Path
) -> None:
    machine.have(ScriptedEngine())
    named = name(recording)
    answer(replace(KEPT, path=str(named)))
    before = sorted(tmp_path.rglob("*"))
    done = ran("record", "--output", str(tmp_path / "mine.mcap"))
    assert done.code == 1
    assert says(done.err, RecordedText.NOT_MOVED)
    assert sorted(tmp_path.rglob("*")) == before


def test_output_takes_no_file_from_elsewhere(
    ran: Any, answer: Any, tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot in a fleet gives this machine's name, and a path here."""
    engine = ScriptedEngine()
    answer(replace(KEPT, path=str(recording)))
    monkeypatch.setattr(engine, "uid", None, raising=False)
    arguments = Namespace(seconds=None, output=str(tmp_path / "mine.mcap"), json=False, attach=lambda **_: engine)
    with pytest.raises(EngineError) as raised:
        record(arguments)
    assert says(str(raised.value), RecordedText.ELSEWHERE, path=recording, host=KEPT.host)
    assert recording.exists()


@pytest.mark.parametrize("seconds", ["0", "-1", "nan"])
def test_no_time_is_wrong_usage(seconds: str, ran: Any, machine: Machine) -> None:
    machine.have(ScriptedEngine())
    done = ran("record", "--seconds", seconds)
    assert (done.code, says(done.err, RecordedText.SECONDS)) == (2, True)


def test_off_is_a_failure(ran: Any, machine: Machine, answer: Any) -> None:
    machine.have(ScriptedEngine())
    answer(KeepProblem.OFF())
    done = ran("record")
    assert (done.code, says(done.err, KeepProblem.OFF)) == (1, True)


@on_main(WIDE, NARROW)
async def test_key_says_where_it_is(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("P")
    await shown(pilot, "9,876")
    await shown(pilot, "/recordings/")


@looking()
async def test_key_works_beside_a_picture(app: ConsoleApp, pilot: Pilot[None], answer: Any) -> None:
    asked = answer(KEPT)
    await comes(pilot, viewed())
    await pilot.press("P")
    await shown(pilot, "/recordings/")
    assert asked == [KeepLast()]


@on_main()
async def test_key_says_how_to_switch_it_on(app: ConsoleApp, pilot: Pilot[None], answer: Any) -> None:
    asked = answer(KeepProblem.OFF())
    await pilot.press("P")
    await shown(pilot, "record: true")
    assert asked == [KeepLast()]


@pytest.mark.parametrize(
    ("value", "where"),
    [
        (RecordLimits(0.5), "record.seconds"),
        (RecordLimits(1e9), "record.seconds"),
        (RecordLimits(float("nan")), "record.seconds"),
        (RecordLimits(30, 0), "record.megabytes"),
        (RecordLimits(30, 1e6), "record.megabytes"),
    ],
)
def test_bounds_have_a_range(value: object, where: str) -> None:
    ((location, message),) = [(each.location, each.message) for each in validate(session(value))]
    assert location == where
    assert says(message, RecordText.OUT_OF_RANGE)


@pytest.mark.parametrize(
    ("value", "limits"), [(False, None), (True, RecordLimits(30, 32)), (RecordLimits(5, 8), RecordLimits(5, 8))]
)
def test_session_says_whether_and_how_much(value: object, limits: RecordLimits | None) -> None:
    assert record_limits(session(value)) == limits
    assert not [*validate(session(value))]


def test_check_advises_to_install_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    advice = [*RecordingFeature().advice(session(True), None)]
    assert advice == [("record", McapText.NOT_INSTALLED())]
    assert not [*RecordingFeature().advice(session(False), None)]
