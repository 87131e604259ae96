"""Rules on the folders of recordings, and what `check` says of them and of who gets recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rsb_bridge.feature import MAY
from rsb_bridge.model.session import Client, Session, session_keys
from rsb_extras.courier import RECORDINGS_KEY, RecordingFolders
from rsb_extras.courier.courier_rules import advice, effects, problems


def session(*folders: str, **others: Any) -> Session:
    given = {"name": "robot1", "role": "client", "server_ip": "10.0.0.20", "server_port": 49152}
    return Session(**{**given, **others}, features={RECORDINGS_KEY.name: RecordingFolders(folders)})


@pytest.mark.parametrize(
    ("folders", "place", "text"),
    [
        (("bags",), "recordings.folders[0]", "bags: give an absolute path"),
        (("/bags", "/a\0b"), "recordings.folders[1]", "has a NUL character or half of a character: remove it"),
        (tuple(f"/bags{number}" for number in range(17)), "recordings.folders", "has 17 folders: at most 16"),
    ],
)
def test_mistakes_name_their_place(folders: tuple[str, ...], place: str, text: str) -> None:
    assert [*problems(session(*folders))] == [(place, text)]


def test_size_of_fetched_recordings_has_a_range() -> None:
    features = {RECORDINGS_KEY.name: RecordingFolders(fetched=0)}
    found = [*problems(Session(name="pc", role="server", server_ip="0.0.0.0", features=features))]
    assert found == [("recordings.fetched", "0 is out of range: 0.01 to 100000")]


def test_folders_that_are_there_have_no_advice(tmp_path: Path) -> None:
    file, missing = tmp_path / "robot1.yaml", str(tmp_path / "missing")
    assert [*problems(session(str(tmp_path), missing))] == []
    (warned,) = advice(session(str(tmp_path), missing), file)
    assert warned[0] == "recordings.folders[1]"
    assert warned[1].startswith(f"{missing} is no folder on this machine")


def test_each_peer_that_gets_recordings_is_named() -> None:
    may = {MAY: session_keys()[MAY].type(recordings=True)}
    clients = (Client("robot1", features=may), Client("robot2"))
    served = [*effects(session("/bags", name="pc", role="server", clients=clients))]
    assert served == [
        "recordings are listed from /bags, and from the bridge's own folder",
        "robot1 may list and get recordings, of the topics that it may read",
    ]
    assert [*effects(session())] == []
