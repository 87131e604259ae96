"""The file by which an operator's console reaches a fleet: what it says, and its mistakes, each with its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from rsb_bridge.config.keys import KeyFileError, write_key
from rsb_bridge.config.session_file import SessionError
from rsb_extras.operators.fleet_file import load_fleet

ZENOH = "zenoh: {connect: [tcp/hub:7447], fleet: lab}\n"
ANNA = "operator: anna\nkey_file: anna.key\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "fleet.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_fleet_file_is_read_with_files_beside_it(tmp_path: Path) -> None:
    key = write_key(tmp_path / "anna.key")
    file = load_fleet(written(tmp_path, ZENOH + ANNA))
    assert (file.zenoh.connect, file.zenoh.fleet) == (("tcp/hub:7447",), "lab")
    assert (file.operator, file.key.secret, file.path.parent) == ("anna", key.secret, tmp_path)


@pytest.mark.parametrize(
    ("text", "locations"),
    [
        ("", {""}),
        (ZENOH, {"operator", "key_file"}),
        (ANNA, {"zenoh"}),
        (ZENOH + "operator: ' '\nkey_file: ''\n", {"operator", "key_file"}),
        (f"{ZENOH}operator: '{256 * 'a'}'\nkey_file: anna.key\n", {"operator"}),
        (f'{ZENOH}operator: "anna\\u202e"\nkey_file: anna.key\n', {"operator"}),
        (f"{ZENOH}{ANNA}operators: []\n", {"operators"}),
        (f"zenoh: {{connect: [hub], fleet: lab}}\n{ANNA}", {"zenoh.connect[0]"}),
        (f"zenoh: {{connect: ['tcp/[fe80::1]:7447'], fleet: lab}}\n{ANNA}", {"zenoh.connect[0]"}),
        (f"zenoh: {{connect: [tcp/hub:7447], fleet: 'a/b'}}\n{ANNA}", {"zenoh.fleet"}),
        (f"zenoh: 3\n{ANNA}", {"zenoh"}),
        ("operator: [\n", {""}),
    ],
)
def test_mistakes_are_named_with_their_places(tmp_path: Path, text: str, locations: set[str]) -> None:
    write_key(tmp_path / "anna.key")
    with pytest.raises(SessionError) as mistakes:
        load_fleet(written(tmp_path, text))
    assert {problem.location for problem in mistakes.value.problems} == locations


def test_a_key_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match=r"anna\.key"):
        load_fleet(written(tmp_path, ZENOH + ANNA))
