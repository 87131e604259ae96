"""Files that are written for a user: nobody else reads them, and nothing in them acts on a terminal."""

from __future__ import annotations

import ast
import csv
import os
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from tests.config.files_helpers import EVIL, mode
from tests.console.scripted import ROUTES, route

from rsb_bridge.config.files import new_file, replace_file, write_whole
from rsb_bridge.config.keys import write_key
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import Event, Level
from rsb_bridge.model.text import is_clean
from rsb_console.session.exports import export_log, export_topics
from rsb_console.terminal.driver import terminal_to_itself

PACKAGES = [
    Path(__file__).parents[2] / each for each in ("bridge/rsb_bridge", "console/rsb_console", "extras/rsb_extras")
]
WRITES_OTHERWISE = {
    "config/files.py": "what is not a file: a device or a pipe; `new_file`",
    "courier/fetch_spool.py": "pieces in a folder of mode 0700",
    "disk_ring/segments.py": "with `owner_only`",
    "demo/demo_session.py": "logs in a temporary folder, mode 0700",
    "bench/loopback.py": "sessions in a temporary folder, mode 0700",
    "bench/kept_messages.py": "messages in such a folder",
    "demo/processes.py": "a log in such a folder",
    "fleet/simulated_fleet.py": "likewise",
    "recording/mcap_file.py": "a file of `new_file`",
    "recording/record_command.py": "the null device, or what `new_file` made",
    "model/text.py": "standard output itself",
    "cli.py": "crash.log, with `owner_only`",
    "terminal_app.py": "crash.txt, with `owner_only`",
    "command/shell.py": "the null device",
}


@pytest.fixture(params=[0o000, 0o022, 0o777])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


@pytest.mark.usefixtures("umask")
def test_new_file_is_its_owners_from_start(tmp_path: Path) -> None:
    with new_file(tmp_path / "a") as file:
        assert mode(tmp_path / "a") == 0o600
        file.write("x")
    assert mode(tmp_path / "a") == 0o600
    write_whole(tmp_path / "b", "x")
    write_key(tmp_path / "c.key")
    assert mode(tmp_path / "b") == mode(tmp_path / "c.key") == 0o600


def test_readable_file_is_owners_after_writing(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_text("old")
    path.chmod(0o666)
    write_whole(path, "new")
    assert (path.read_text(), mode(path)) == ("new", 0o600)


def test_half_a_new_file_does_not_stay(tmp_path: Path) -> None:
    with pytest.raises(UnicodeEncodeError), new_file(tmp_path / "a") as file:
        file.write("x\ud800")
    assert not (tmp_path / "a").exists()


def test_no_symbolic_link_is_followed_to_new_file(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="a"), new_file(tmp_path / "a"):
        pass
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to be somebody else")
@pytest.mark.parametrize("is_there", [True, False])
def test_symbolic_link_of_another_user_is_not_followed(tmp_path: Path, *, is_there: bool) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    if is_there:
        target.write_text("old")
    link.symlink_to(target)
    os.chown(link, 1234, 1234, follow_symlinks=False)
    with pytest.raises(OSError, match="link"):
        write_whole(link, "new")
    with pytest.raises(OSError, match="link"):
        replace_file(link, b"new")
    assert not is_there or target.read_text() == "old"
    os.chown(link, 0, 0, follow_symlinks=False)
    if is_there:
        write_whole(link, "new")
        assert target.read_text() == "new"


@pytest.mark.usefixtures("umask")
def test_exports_are_the_owners_and_clean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    folder.chmod(0o700)
    monkeypatch.chdir(folder)
    event = Event(1, 1_700_000_000.0, Level.INFO, EventCode.LINK_UP, EVIL, link=EVIL, topic=EVIL, who=EVIL)
    export_log([event])
    export_topics([replace(route(f"/{EVIL}", outgoing=True), reason=EVIL, type_name=f"={EVIL}"), *ROUTES])
    write_whole(folder / "plot.svg", f"<svg>{EVIL}</svg>")
    paths = list(folder.iterdir())
    assert len(paths) == 3
    for path in paths:
        assert mode(path) == 0o600
        text = path.read_bytes().decode()
        assert is_clean(text.replace("\r\n", "").replace("\n", ""))
        assert path.suffix == ".svg" or not [line for line in text.splitlines() if line.startswith("2026-01-01 forged")]
    (table,) = folder.glob("rsb-topics-*.csv")
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert len(rows) == len(ROUTES) + 1


def test_files_of_before_are_closed_to_others(tmp_path: Path) -> None:
    (tmp_path / "output.txt").write_text("")
    (tmp_path / "output.txt").chmod(0o666)
    with terminal_to_itself(tmp_path / "output.txt"):
        pass
    assert {mode(path) for path in tmp_path.iterdir()} == {0o600}


def writes(tree: ast.AST) -> bool:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            values = [*node.args, *(each.value for each in node.keywords if each.arg == "mode")]
            modes = [each.value for each in values if isinstance(each, ast.Constant) and isinstance(each.value, str)]
            is_open = name == "open" or name.endswith((".open", "fdopen"))
            if name.endswith((".write_text", ".write_bytes")) or (
                is_open and any(set(each) <= set("wax+bt") and set(each) & set("wax") for each in modes)
            ):
                return True
    return False


def test_all_modules_write_files_privately() -> None:
    found = {
        path.relative_to(package).as_posix()
        for package in PACKAGES
        for path in package.rglob("*.py")
        if "tests" not in path.relative_to(package).parts
        and re.search(r"write_(text|bytes)|open\(", text := path.read_text())
        and writes(ast.parse(text))
    }
    assert found <= set(WRITES_OTHERWISE), found - set(WRITES_OTHERWISE)
