"""The setting `commands`: what it may say, and which values a command takes."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.other_user import only_root, theirs
from tests.support.wording import says

from rsb_console.actions.action import Group
from rsb_console.preferences import PreferenceProblem, Preferences
from rsb_extras.own_commands.own_command import (
    COMMANDS,
    CommandMistake,
    OwnCommand,
    UnsafeValueError,
    read_commands,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from rsb_bridge.model.wording import Wording

VALUES = {"robot": "robot1", "topic": "/scan", "link": "robot1", "type": "std_msgs/msg/String", "state": "ok"}
NASTY = (
    "$(touch {file})", "`touch {file}`", "; touch {file}", "&& touch {file}", "| touch {file}", "a\ntouch {file}",
    "' ; touch {file} ; '", '" ; touch {file} ; "', "$HOME", "*", "a b", "-oProxyCommand=touch {file}", "~root", "a\0b",
    "a\\", "{{topic}}", "#", "<(touch {file})", "!!", "",
)  # fmt: skip


def command(run: str, **fields: Any) -> OwnCommand:
    (made,) = read_commands({"X": {"run": run, "where": "topic", **fields}})
    return made


def test_placeholders_become_what_is_under_the_cursor() -> None:
    line = 'ssh {robot} "ros2 topic info {topic} {type}" # {link} {state}'
    made = command(line).line(VALUES)
    assert made == 'ssh robot1 "ros2 topic info /scan std_msgs/msg/String" # robot1 ok'


@pytest.mark.parametrize("value", NASTY)
@pytest.mark.parametrize("run", ["echo {topic}", 'echo "{topic}"', "echo '{topic}'", "sh -c 'echo {topic}'"])
def test_nasty_name_is_refused_in_any_quotes(run: str, value: str) -> None:
    with pytest.raises(UnsafeValueError):
        command(run).line(VALUES | {"topic": value.format(file="/tmp/x")})


@pytest.mark.parametrize(
    "run", ["echo {topic}", 'echo "{topic}"', "echo `echo {topic}`", "sh -c 'sh -c \"echo {topic}\"'"]
)
@pytest.mark.parametrize("value", ["/a/b_2", "10.0.0.7", "fe80::1%eth0", "user@host", "pkg/msg/T", "a=b", "a,b+c"])
def test_plain_name_is_itself_in_all_shells(run: str, value: str) -> None:
    line = command(run).line(VALUES | {"topic": value})
    assert subprocess.run(["/bin/sh", "-c", line], capture_output=True, text=True, check=True).stdout == f"{value}\n"


@pytest.mark.parametrize("run", ["awk '{ print $1 }'", "echo ${topic}", "docker ps --format '{{topic}}'", "echo {a,b}"])
def test_braces_of_the_shell_stay(run: str) -> None:
    assert command(run).line({}) == run


@pytest.mark.parametrize(
    ("given", "problem", "parameters"),
    [
        (["x"], CommandMistake.NO_MAPPING, {}),
        (None, CommandMistake.NO_MAPPING, {}),
        ({f"f{number}": {"run": "true"} for number in range(99)}, CommandMistake.TOO_MANY, {}),
        ({"nope": {"run": "true"}}, CommandMistake.NO_KEY, {"key": "nope"}),
        ({"tab": {"run": "true"}}, CommandMistake.TAKEN, {"key": "tab"}),
        ({"X": "true"}, CommandMistake.NO_COMMAND, {"key": "X"}),
        ({"X": {"where": "all"}}, CommandMistake.NO_COMMAND, {"key": "X"}),
        ({"X": {"run": "true", "runs": 1}}, CommandMistake.UNKNOWN_FIELDS, {"key": "X", "fields": "runs"}),
        ({"X": {"run": 7}}, CommandMistake.FIELD, {"key": "X", "field": "run"}),
        ({"X": {"run": "a\x1b[2J"}}, CommandMistake.FIELD, {"key": "X", "field": "run"}),
        ({"X": {"run": " "}}, CommandMistake.FIELD, {"key": "X", "field": "run"}),
        ({"X": {"run": "true", "description": "two\nlines"}}, CommandMistake.FIELD, {"field": "description"}),
        ({"X": {"run": "true", "confirm": "yes"}}, CommandMistake.FIELD, {"field": "confirm"}),
        ({"X": {"run": "true", "where": "robot"}}, CommandMistake.FIELD, {"field": "where"}),
        ({"X": {"run": "true", "where": ["topic"]}}, CommandMistake.FIELD, {"field": "where"}),
        ({"X": {"run": "echo {robt}"}}, CommandMistake.NO_PLACEHOLDER, {"name": "robt"}),
        ({"X": {"run": "echo {robot}"}}, CommandMistake.NEEDS_PLACE, {"name": "robot", "places": "link or topic"}),
        ({"X": {"run": "echo {type}", "where": "link"}}, CommandMistake.NEEDS_PLACE, {"places": "topic"}),
    ],
)  # fmt: skip
def test_mistake_names_its_place(given: object, problem: Wording, parameters: dict[str, object]) -> None:
    with pytest.raises(ValueError) as raised:
        read_commands(given)
    assert says(raised.value, problem, **parameters)
    assert str(raised.value).startswith("commands")


@pytest.mark.parametrize(
    ("written", "key"), [("Y", "Y"), ("'!'", "exclamation_mark"), ("5", "5"), ("f9", "f9"), ("ctrl+g", "ctrl+g")]
)
def test_keys_are_textuals_or_a_character(tmp_path: Path, written: str, key: str) -> None:
    (tmp_path / "console.yaml").write_text(f'commands: {{{written}: {{run: "true"}}}}')
    (made,) = COMMANDS.of(Preferences(tmp_path, None))
    assert (made.key, made.where, made.confirm, made.changes) == (key, "all", False, True)


@pytest.mark.parametrize(
    ("keys", "key", "owner"), [("", "p", "pause"), ("pause: Y", "Y", "pause"), ("", "question_mark", "help")]
)
def test_taken_key_names_both_and_keeps_others(tmp_path: Path, keys: str, key: str, owner: str) -> None:
    (tmp_path / "keys.yaml").write_text(keys)
    (tmp_path / "console.yaml").write_text(f'bell: true\ncommands: {{{key}: {{run: "true"}}, Z: {{run: "true"}}}}')
    found = Preferences(tmp_path, None)
    ((_, reported),) = found.problems
    shared = PreferenceProblem.SHARED_KEY
    assert says(reported, shared, path=tmp_path / "console.yaml", key=key, one=owner, other=f"command_{key}")
    assert [action.id for action in found.actions if action.id.startswith("command_")] == ["command_Z"]
    assert found.bell


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(theirs, marks=only_root),
        pytest.param(lambda path: theirs(path.parent), marks=only_root),
        lambda path: path.chmod(0o666),
        lambda path: path.parent.chmod(0o777),
        None,
    ],
    ids=["owner", "folder's owner", "mode", "folder's mode", "nobody"],
)
def test_file_that_others_can_change_has_no_commands(tmp_path: Path, change: Callable[[Path], object] | None) -> None:
    path = tmp_path / "console.yaml"
    path.write_text("commands:\n  f9: {run: uptime}\n")
    if change is not None:
        change(path)
    preferences = Preferences(tmp_path, None)
    assert [each.id for each in preferences.actions if each.group is Group.OWN] == ["command_f9"] * (change is None)
    assert [says(text, CommandMistake.OF_OTHERS) for _, text in preferences.problems] == [True] * (change is not None)
