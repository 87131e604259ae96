"""Files of the history are their owner's alone, and nothing in them acts on a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.config.files_helpers import EVIL, mode

from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level
from rsb_bridge.model.text import is_clean
from rsb_extras.history.history_data import HistoryReport
from rsb_extras.history.history_files import EventFile
from rsb_extras.history.history_report import export_history

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

EVENT = Event(1, 1_700_000_000.0, Level.INFO, EventCode.LINK_UP, EVIL, link=EVIL, topic=EVIL, who=EVIL)


def test_exported_history_is_private_and_clean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    export_history(HistoryReport(EVIL, "client", 1_700_000_100.0, span=100.0, running=True, actions=(EVENT,)))
    paths = list(tmp_path.iterdir())
    assert len(paths) == 2
    for path in paths:
        assert mode(path) == 0o600
        text = path.read_bytes().decode()
        assert is_clean(text.replace("\r\n", "").replace("\n", ""))
        assert not [line for line in text.splitlines() if line.startswith("2026-01-01 forged")]


def test_open_event_file_becomes_private(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text("")
    path.chmod(0o666)
    file = EventFile(path)
    file.write([EVENT])
    file.close()
    assert mode(path) == 0o600
