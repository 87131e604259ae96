"""Every command line of the documents is one that the command takes; what can run here is run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import pytest
from tests.console.scripted import SESSION, ScriptedEngine, route

from rsb_bridge.model.session import Topic
from rsb_console.command.arguments import parser_and_commands

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.support.control import Machine

_ROOT = Path(__file__).parents[2]
_PAGES = [_ROOT / "README.md", _ROOT / "SECURITY.md", *sorted((_ROOT / "docs").glob("*.md"))]
_SEPARATORS = frozenset(("|", "&&", "||", ";", "&", ">", ">>", "<"))
_PLACEHOLDERS = {"SHELL": "bash"}


class Line(NamedTuple):
    """A command line of a page.

    Attributes:
        whole: whether it stands in a block, so that readers copy it. In a sentence it may lack arguments.
    """

    place: str
    words: list[str]
    whole: bool


def lines() -> Iterator[Line]:
    for page in _PAGES:
        in_block = False
        for number, text in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            place = f"{page.relative_to(_ROOT)}:{number}"
            if text.lstrip().startswith("```"):
                in_block = not in_block
            elif in_block:
                yield from (Line(place, words, True) for words in commands(text))
            else:
                for code in re.findall(r"`(rsb-console [^`]+)`", text):
                    yield from (Line(place, words, False) for words in commands(code))


def commands(text: str) -> Iterator[list[str]]:
    """The arguments of each call of `rsb-console` in a line of shell."""
    if not re.search(r"(^|[\s(])rsb-console\s", text):
        return
    text = re.sub(r"\w+=\$\((.*?)\)$", r"\1", text.strip().removeprefix("$ "))
    splitter = shlex.shlex(text, posix=True, punctuation_chars="|&;<>")
    splitter.whitespace_split = True
    splitter.commenters = "#"
    words: list[str] = []
    for word in [*splitter, ";"]:
        if word not in _SEPARATORS:
            words.append(_PLACEHOLDERS.get(word, word))
            continue
        if words and words[0] == "rsb-console":
            yield words[1:]
        words = []


FOUND = [*lines()]


def test_they_are_found() -> None:
    assert len(FOUND) > 60
    assert [*commands("rsb-console wait --for flowing /scan && ros2 topic list  # then")] == [
        ["wait", "--for", "flowing", "/scan"]
    ]
    assert [*commands("goal=$(rsb-console call /a '{b: c d}' --json | jq -r .id)")] == [
        ["call", "/a", "{b: c d}", "--json"]
    ]


@pytest.mark.parametrize("line", FOUND, ids=[f"{line.place} {line.words[0]}" for line in FOUND])
def test_it_is_taken(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    parser, names = parser_and_commands()
    words = line.words
    if words[0].startswith("-"):
        assert words[0] in parser.format_help()
        return
    if words[0] not in names:  # rsb-console SESSION
        words = ["run", *words]
    try:
        parser.parse_args(words)
    except SystemExit:
        error = capsys.readouterr().err
        assert not line.whole, error
        assert "the following arguments are required" in error, error


# --- those that can be run against a bridge that is scripted, or in an empty folder

_RUN = {
    "add",
    "completion",
    "info",
    "keygen",
    "pause",
    "reload",
    "remove",
    "restart",
    "retry",
    "status",
    "topics",
    "wait",
}
_NOT_RUN = {
    "SESSION": "stands for a file",
    "--version": "ends the interpreter; test_command runs it",
    "ack": "its topic is a placeholder; test_remote runs it",
    "arm": "its topic is a placeholder, and it lasts until Ctrl-C; test_remote runs it",
    "attach": "opens the console; tests/console run it",
    "bench": "measures for a minute or needs two sides; tests/bench run it",
    "bt-scan": "needs a Bluetooth adapter; tests/bluetooth run it in a virtual machine",
    "bw": "lasts until Ctrl-C; test_figures runs it",
    "call": "needs the types of the service; test_calls runs it",
    "check": "its file is a placeholder; test_command runs it",
    "client": "changes a server's file and its running bridge; test_client runs it",
    "control.yaml": "opens the console",
    "demo": "needs ROS for half a minute; test_demo_fleet runs it",
    "echo": "needs messages; test_echo runs it",
    "edit": "its topics are a pattern's or need arming; test_remote runs it",
    "fleet": "needs several bridges; test_fleet runs it",
    "hz": "lasts until Ctrl-C; test_figures runs it",
    "import": "needs the session of another program; test_command runs it",
    "param": "needs a node; test_calls runs it",
    "report": "needs a recorded history; test_report runs it",
    "robot2.yaml": "opens the console",
    "run": "is a bridge of its own; tests/system run it",
    "stop": "waits for the end of the process; test_remote runs it",
    "service": "changes systemd; test_service runs it",
}
_NOT_WHOLE = ("info", "pause", "wait --for flowing", "wait --for flowing /map_server/load_map")
"""Lines of a command in `_RUN` that name no topic, or wait for a service that nobody has."""


@pytest.fixture
def engine(machine: Machine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ScriptedEngine:
    """A bridge that has the topics of the documents."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", machine.environ["XDG_RUNTIME_DIR"])
    monkeypatch.chdir(tmp_path)
    names = ("/scan", "/camera", "/rsb_bench/tcp/transmit", "/cmd_vel")
    routes = [route(name, key=name, outgoing=True, spec=Topic(name, "transmit")) for name in names]
    topics = tuple(each.spec for each in routes if each.spec)
    made = ScriptedEngine(msgspec.structs.replace(SESSION, topics=topics), routes=tuple(routes))
    machine.serve(made)
    return made


def test_each_command_is_run_or_has_a_reason_not_to_be() -> None:
    assert {line.words[0] for line in FOUND} == _RUN | set(_NOT_RUN)


def can_run(line: Line) -> bool:
    """Whether a line has no placeholder and needs nothing but the scripted bridge."""
    text = " ".join(line.words)
    placeholder = any(each.isupper() for each in line.words)
    return line.words[0] in _RUN and not placeholder and not text.endswith(_NOT_WHOLE) and "--fleet " not in text


@pytest.mark.parametrize("line", [*filter(can_run, FOUND)], ids=lambda line: f"{line.place} {line.words[0]}")
def test_it_does_what_it_says(line: Line, engine: ScriptedEngine, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = parser_and_commands()[0].parse_args(line.words)
    assert arguments.command(arguments) == 0, capsys.readouterr().err
    assert engine.session.name == "robot1"
