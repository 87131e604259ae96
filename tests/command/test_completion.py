"""Completion on TAB, as a shell asks argcomplete for it: through the environment."""

from __future__ import annotations

import argparse
import io
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import argcomplete
import msgspec
import pytest
from tests.console.scripted import SESSION, ScriptedEngine, route
from tests.support import constants, replaced
from tests.support.captured import captured
from tests.support.commands import options_of, parser_and_commands, subcommands_of

from rsb_bridge.model.session import Topic
from rsb_bridge.model.transports import Protocol
from rsb_console.command import arguments, completion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.support.control import Machine

COMMAND = Path(sys.executable).with_name("rsb-console")
_ROOT = Path(__file__).parents[2]
SCAN = route("/scan", outgoing=True, spec=Topic("/scan", "transmit"))
DOCK = route("/dock", spec=Topic("/dock", "receive", kind="service"))
NODE = route("/controller", spec=Topic("/controller", "receive", kind="parameters"))


@pytest.fixture(autouse=True)
def engine(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> ScriptedEngine:
    monkeypatch.setenv("XDG_RUNTIME_DIR", machine.environ["XDG_RUNTIME_DIR"])
    made = ScriptedEngine(msgspec.structs.replace(SESSION, topics=(SCAN.spec,)), routes=(SCAN, DOCK, NODE))
    machine.serve(made)
    return made


@pytest.fixture
def offered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], set[str]]:
    """Gives what is offered for a line that ends at the cursor, in an empty folder."""
    folder = tmp_path / "folder"
    folder.mkdir()
    monkeypatch.chdir(folder)
    constants.COMPLETION_WAITS.set(monkeypatch, 60.0)  # the server's thread is this process's, and may stand still
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)  # completion replaces it
    replaced.ARGCOMPLETE_DEBUG_STREAM.set(monkeypatch, lambda _: None)  # it takes descriptor 9

    def offered(line: str) -> set[str]:
        answer = io.StringIO()
        ask = partial(argcomplete.autocomplete, exit_method=sys.exit, output_stream=answer)
        with monkeypatch.context() as patch:
            replaced.ARGCOMPLETE.set(patch, ask)
            patch.setenv("_ARGCOMPLETE", "1")
            patch.setenv("_ARGCOMPLETE_IFS", "\n")
            patch.setenv("COMP_LINE", line)
            patch.setenv("COMP_POINT", str(len(line)))
            with pytest.raises(SystemExit) as ended:
                completion.complete(*arguments.parser_and_commands())  # a parser of its own, which argcomplete changes
        assert not ended.value.code
        return {each.rstrip() for each in answer.getvalue().split("\n")} - {""}

    return offered


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("rsb-console attach ro", {"robot1"}),
        ("rsb-console status --bridge ", {"robot1"}),
        ("rsb-console pause /", {"/scan", "/dock", "/controller"}),
        ("rsb-console pause --kind service /", {"/dock"}),
        ("rsb-console pause robot1 /s", {"/scan"}),
        ("rsb-console pause robot1 ", {"/scan", "/dock", "/controller"}),
        ("rsb-console pause ", {"robot1", "/scan", "/dock", "/controller"}),
        ("rsb-console pause rob", {"robot1"}),
        ("rsb-console edit robot1 /scan priority=l", {"priority=low"}),
        ("rsb-console add robot1 /scan ", {"transmit", "receive"}),
        ("rsb-console pause --direction transmit /", {"/scan"}),
        ("rsb-console echo /", {"/scan"}),
        ("rsb-console call /", {"/dock", "/controller"}),
        ("rsb-console edit /scan --link ", {"robot1"}),
        ("rsb-console pause --bridge nobody /", set()),
        ("rsb-console add /scan ", {"transmit", "receive"}),
        ("rsb-console add /scan transmit max", {"max_rate=", "max_age="}),
        ("rsb-console add --service /dock --provider ", {"client", "server"}),
        ("rsb-console add --service /dock time", {"timeout="}),
        ("rsb-console add --kind ", {"topic", "service", "action", "parameters"}),
        ("rsb-console edit /scan protocol=", {f"protocol={each}" for each in get_args(Protocol)}),
        ("rsb-console edit /scan priority=l", {"priority=low"}),
        ("rsb-console edit /scan paused=", {"paused=true", "paused=false"}),
        ("rsb-console edit /scan qos=sen", {"qos=sensor_data"}),
        ("rsb-console call /controller --lane set", {"set_parameters", "set_parameters_atomically"}),
        ("rsb-console param set /controller a 1 --type byte", {"byte_array"}),
        ("rsb-console wait --for ", {"flowing", "linked", "stopped"}),
        ("rsb-console client remove ", {"robot1"}),
        ("rsb-console client add ", set()),
        ("rsb-console completion ", {"bash", "zsh", "fish"}),
        ("rsb-console keygen rob", {"robot1.key"}),
        ("rsb-console demo --seconds ", set()),
        ("rsb-console import a.yaml --name ", set()),
        ("rsb-console run --control rob", {"robot1.key"}),
    ],
)  # fmt: skip
def test_it_is_offered(line: str, expected: set[str], offered: Callable[[str], set[str]]) -> None:
    Path("robot1.key").touch()
    found = offered(line)
    keys = {each for each in found if each.endswith("=")} - expected
    options = {each for each in found if each.startswith("-")}
    assert found - keys - options == expected
    assert not keys or line.endswith(" ")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("rsb-console ke", {"keygen"}),
        ("rsb-console run --lo", {"--log-format"}),
        ("rsb-console c", {"call", "check", "client", "completion", "component", "control.yaml", "configs/"}),
        ("rsb-console check configs/", {"configs/a.yml"}),
        ("rsb-console run ", {"robot1.yaml", "control.yaml", "configs/"}),
        ("rsb-console control.yaml --log-format ", {"text", "json"}),
        ("rsb-console run --theme hi", {"high-contrast"}),
    ],
)
def test_commands_options_sessions_and_themes_are_offered(
    line: str, expected: set[str], offered: Callable[[str], set[str]]
) -> None:
    Path("configs").mkdir()
    for name in (
        "robot1.yaml",
        "control.yaml",
        "notes.txt",
        "cube.txt",
        ".hidden.yaml",
        "configs/a.yml",
        "configs/b.key",
    ):
        Path(name).touch()
    assert {each for each in offered(line) if not each.startswith("-") or line.endswith("--lo")} == expected


def test_add_offers_topics_that_can_be_bridged(engine: ScriptedEngine, offered: Callable[[str], set[str]]) -> None:
    known = {info.topic for info in engine.topics().result() if info.kind == "topic"}
    assert known
    assert offered("rsb-console add /") >= known


def test_what_several_bridges_have_waits_for_a_name(machine: Machine, offered: Callable[[str], set[str]]) -> None:
    other = ScriptedEngine(msgspec.structs.replace(SESSION, name="robot2"), routes=(replace(SCAN, topic="/other"),))
    other.now = replace(other.now, name="robot2")
    machine.serve(other)
    assert offered("rsb-console echo /") == set()
    assert offered("rsb-console echo --bridge robot2 /") == {"/other"}


def test_no_argument_is_left_out() -> None:
    """Every argument is completed, has choices, or takes something that nobody can list."""
    free = {
        "N", "HZ", "BYTES", "SECONDS", "SPAN", "YAML", "VALUE", "PATTERN", "ADDRESS", "N,...", "A,B", "NAME,...",
        "DEGREES", "FRAME", "TEXT", "TIME",
    }  # fmt: skip
    own = {
        "audit --pair", "import --name", "import --port", "client add NAME", "pub --type", "review TOPIC",
        "record --keep", "record --with", "component load PACKAGE", "component load PLUGIN",
        *(f"component load --{option}" for option in ("name", "namespace", "param", "remap")),
    }  # fmt: skip

    def missing(parser: argparse.ArgumentParser, name: str) -> Iterator[str]:
        for word, each in subcommands_of(parser).items():
            yield from missing(each, f"{name} {word}".strip())
        for action in options_of(parser):
            if isinstance(action.choices, dict):
                continue
            takes = action.nargs != 0 and not hasattr(action, "completer") and not action.choices
            if takes and action.type is not Path and action.metavar not in {*free, "PATH", "FILE", "FILE.svg"}:
                yield f"{name} {action.option_strings[-1] if action.option_strings else action.metavar}"

    assert set(missing(parser_and_commands()[0], "")) == own


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes_with_what_is_installed(tmp_path: Path) -> None:
    script = f"""
        PATH={COMMAND.parent}:$PATH
        source {_ROOT}/completions/rsb-console.bash
        complete -p rsb-console
        COMP_LINE='rsb-console keyg' COMP_POINT=16 COMP_TYPE=9
        COMP_WORDBREAKS=' =' COMP_WORDS=(rsb-console keyg) COMP_CWORD=1
        _python_argcomplete rsb-console keyg rsb-console
        echo "${{COMPREPLY[@]}}"
    """
    run = captured("bash", "--norc", "-c", script, cwd=tmp_path)
    assert run.stdout.split()[-2:] == ["rsb-console", "keygen"], run.stderr


@pytest.mark.parametrize(
    ("shell", "file", "word"),
    [("zsh", "_rsb-console", "compdef"), ("fish", "rsb-console.fish", "complete --command rsb-console")],
)
def test_the_other_shells_get_theirs(shell: str, file: str, word: str) -> None:
    assert f"rsb-console completion {shell}" in (_ROOT / "completions" / file).read_text()
    run = subprocess.run([COMMAND, "completion", shell], capture_output=True, text=True, timeout=180, check=False)
    assert run.returncode == 0
    assert word in run.stdout


def test_bridge_that_does_not_answer_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    replaced.ATTACHED.set(monkeypatch, lambda *_, **__: time.sleep(60))
    constants.COMPLETION_WAITS.set(monkeypatch, 0.01)
    assert completion.links(argparse.Namespace()) == []
