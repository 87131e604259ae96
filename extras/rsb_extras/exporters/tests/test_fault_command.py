"""The command of `on_fault`: how it is written, found, and what `check` says of it."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest
from tests.config.mistakes import problems
from tests.console.scripted import SESSION

from rsb_bridge.config.programs import program_path, program_problem
from rsb_bridge.config.session_changes import changes
from rsb_bridge.config.session_file import dump, load, save, validate
from rsb_extras.exporters import FEATURE, ON_FAULT
from rsb_extras.exporters.fault_command import command_words


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("notify.sh --urgent", ("notify.sh", "--urgent")),
        ("./tell 'the operator' now", ("./tell", "the operator", "now")),
        (("./tell", "the operator", ""), ("./tell", "the operator", "")),
        ("logger -t rsb; reboot", ("logger", "-t", "rsb;", "reboot")),
        ("echo $HOME `id`", ("echo", "$HOME", "`id`")),
    ],
)
def test_command_is_split_without_shell(command: str | tuple[str, ...], words: tuple[str, ...]) -> None:
    assert command_words(command) == words


@pytest.mark.parametrize("command", ["", "  ", (), ("",), "notify 'me", "a\0b", "x" * 10_000])
def test_what_is_no_command_is_refused(command: str | tuple[str, ...]) -> None:
    assert [
        problem.location for problem in validate(msgspec.structs.replace(SESSION, features={"on_fault": command}))
    ] == ["on_fault"]


@pytest.mark.parametrize(
    ("value", "places"), [*((each, ["on_fault"]) for each in ("7", "true", "{a: b}")), ("[a, 2]", ["on_fault[1]"])]
)
def test_what_is_neither_text_nor_list_of_texts_is_refused(value: str, places: list[str]) -> None:
    assert [problem.location for problem in problems(f"{dump(SESSION)}on_fault: {value}\n")] == places


@pytest.mark.parametrize("command", ["./tell 'the operator'", ("./tell", "the operator")])
def test_a_file_keeps_it(command: str | tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    save(msgspec.structs.replace(SESSION, features={"on_fault": command}), path)
    assert ON_FAULT.of(load(path)) == command


def program(path: Path, mode: int = 0o755) -> Path:
    path.write_text("#!/bin/sh\n")
    path.chmod(mode)
    return path


def test_path_is_relative_to_session_name_to_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bin").mkdir()
    here, there = program(tmp_path / "tell"), program(tmp_path / "bin" / "notify")
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert program_path("./tell", tmp_path) == here
    assert program_path("~/tell", tmp_path / "elsewhere") == here
    assert program_path(str(here), tmp_path / "elsewhere") == here
    assert program_path("notify", tmp_path) == there
    assert program_path("tell", tmp_path) is None, "a file in the session's folder has ./ before its name"


def test_what_keeps_it_from_being_run(tmp_path: Path) -> None:
    plain = program(tmp_path / "plain", 0o644)
    assert program_problem("/bin/sh", tmp_path) == ""
    for name in (
        "./gone",
        "no-such-program-at-all",
        str(tmp_path),
        "./" + "x" * 300,
        *([] if os.access(plain, os.X_OK) else ["./plain"]),
    ):
        assert program_problem(name, tmp_path)


@pytest.mark.parametrize(
    ("command", "count"),
    [
        ("./tell", 0),
        ("./gone", 1),
        ("./tell | mail root", 1),
        ("./tell $NAME", 1),
        ("./open", 1),
        ("./" + "x" * 300, 1),
    ],
)
def test_check_warns(command: str, count: int, tmp_path: Path) -> None:
    program(tmp_path / "tell")
    program(tmp_path / "open", 0o777)
    path = tmp_path / "robot1.yaml"
    session = msgspec.structs.replace(SESSION, features={"on_fault": command})
    save(session, path)
    assert len([*FEATURE.advice(session, path)]) == count


def test_check_warns_of_session_that_others_may_change(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    session = msgspec.structs.replace(SESSION, features={"on_fault": "/bin/true"})
    save(session, path)
    path.chmod(0o666)
    assert len([*FEATURE.advice(session, path)]) == 1
    assert [*FEATURE.advice(msgspec.structs.replace(session, features={}), path)] == []


def test_log_of_reload_does_not_have_command_line() -> None:
    before, after = (
        msgspec.structs.replace(SESSION, features={"on_fault": f"/bin/true secret{each}"}) for each in (1, 2)
    )
    for old, new in ((before, after), (SESSION, after), (after, SESSION)):
        (change,) = changes(old, new, only=("on_fault",))
        assert "secret" not in change
