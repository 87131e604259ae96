"""Every command line of the documents is one that the command takes, and it works where it can be run here."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import signal
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import pytest
from tests.console.scripted import LINK, NOW, SESSION, ScriptedEngine, call_route, route, whole_answer
from tests.support import constants, replaced, surroundings
from tests.support.commands import parser_and_commands
from tests.support.fleet import ServerEngine, topics
from tests.support.foreign_files import BRINGUP, DOMAINS
from tests.support.operators import ANNA
from tests.support.running import Running

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.feature import BRINGS_COMMANDS
from rsb_bridge.model.commands import Call, CallWhole
from rsb_bridge.model.session import Client, Topic
from rsb_bridge.model.snapshot import PatternSnapshot, PeekedMessage, State
from rsb_console.command.shell import INTERRUPTED, OK

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator
    from concurrent.futures import Future

    from tests.support.control import Machine

    from rsb_bridge.control.control_server import ControlServer
    from rsb_bridge.model.commands import Command

_ROOT = Path(__file__).parents[2]
_OF_FEATURES = sorted(_ROOT.glob("extras/rsb_extras/*/docs/*.md"))
_PAGES = [_ROOT / "README.md", _ROOT / "SECURITY.md", *sorted((_ROOT / "docs").glob("*.md")), *_OF_FEATURES]
_SEPARATORS = frozenset(("|", "&&", "||", ";", "&", ">", ">>", "<"))
_PLACEHOLDERS = {
    "CLIENT": "robot1", "FILE": "robot1.yaml", "NAME": "robot1", "PATH": "setup.bash", "SESSION": "robot1.yaml",
    "SHELL": "bash", "TOPIC": "/scan",
}  # fmt: skip


class Line(NamedTuple):
    """A command line of a page.

    Attributes:
        whole: whether it is in a block, so that readers copy it. In a sentence it may lack arguments.
    """

    place: str
    words: list[str]
    whole: bool

    @property
    def text(self) -> str:
        return shlex.join(self.words)


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


MISSING = BRINGS_COMMANDS.keys() - parser_and_commands()[1]
FOUND = [line for line in lines() if line.words[0] not in MISSING]


def parsed(text: str) -> argparse.Namespace:
    parser, names = parser_and_commands()
    words = shlex.split(text)
    if words[0] not in (*names, "--version"):  # rsb-console SESSION
        words = ["run", *words]
    return parser.parse_args(words)


def test_they_are_found() -> None:
    assert len(FOUND) > 60
    assert [*commands("rsb-console wait --for flowing /scan && ros2 topic list  # then")] == [
        ["wait", "--for", "flowing", "/scan"]
    ]
    assert [*commands("goal=$(rsb-console call /a '{b: c d}' --json | jq -r .id)")] == [
        ["call", "/a", "{b: c d}", "--json"]
    ]


def lacks_arguments(line: Line) -> bool:
    """Whether a sentence only names a command, without the arguments that it needs."""
    with contextlib.redirect_stderr(io.StringIO()) as errors, contextlib.suppress(SystemExit):
        parsed(line.text)
    return not line.whole and "the following arguments are required" in errors.getvalue()


def ids(line: Line) -> str:
    return f"{line.place} {line.words[0]}"


@pytest.mark.parametrize("line", FOUND, ids=ids)
def test_it_is_taken(line: Line, capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.suppress(SystemExit):
        parsed(line.text)
    assert lacks_arguments(line) or not capsys.readouterr().err


_OF_BENCH = "../extras/rsb_extras/bench/tests/test_command.py"
_OF_DEMO = "../extras/rsb_extras/demo/tests/test_demo.py"
_OF_FLEET = "../extras/rsb_extras/fleet/tests/test_demo_fleet.py"
_OF_PLAY = "../extras/rsb_extras/playing/tests/test_playing.py"
_OF_REVIEW = "../extras/rsb_extras/playing/tests/test_review.py"
_ELSEWHERE = {
    "bench": (_OF_BENCH, "test_ctrl_c_prints_results_and_leaves_no_process"),
    "bench --quick": (_OF_BENCH, "test_a_short_run_on_this_machine"),
    "bt-scan": ("bluetooth/guest/test_scan.py", "test_what_the_command_prints"),
    "demo": (_OF_FLEET, "test_no_process_outlives_a_demo_that_is_killed"),
    "demo --no-ui --seconds 20": (_OF_DEMO, "test_demo_bridges_and_leaves_one_topic_to_add"),
    "demo --fleet": (
        _OF_FLEET, "test_screen_opens_leads_to_robot_and_back"
    ),
    "demo --fleet --no-ui --seconds 30": (
        _OF_FLEET, "test_each_engine_is_linked_and_has_a_line"
    ),
    "mcp": ("../extras/rsb_extras/mcp_server/tests/test_mcp.py", "test_each_reading_tool_answers"),
    "play bag --domain 5": (_OF_PLAY, "test_all_messages_arrive_as_recorded"),
    "play bag --domain 5 --topics '/camera/**' /tf --rate 0.5": (_OF_PLAY, "test_times_between_messages_are_kept"),
    "play bag --domain 5 --from 60 --to 90 --loop --clock": (_OF_PLAY, "test_part_and_topics_are_chosen"),
    "review bag": (_OF_REVIEW, "test_screen_lists_topics_and_shows_one"),
    "review stretch.mcap /camera/image_raw --at 42.5": (_OF_REVIEW, "test_it_leaves_the_terminal_as_it_was"),
    "run robot1.yaml --no-ui": (
        "command/test_remote.py", "test_headless_bridge_is_attached_to_changed_and_stopped"
    ),
}  # fmt: skip
"""Lines that need nodes, minutes, a program or an adapter, and the test that runs the command with these options."""
_COMPLETE = {"fleet dismiss robot1": "fleet dismiss robot9", "wait --for flowing": "wait --for flowing /scan"}
"""Lines whose placeholder is a robot that has gone, or whose condition a sentence leaves open."""
_BEFORE = {
    "client rekey robot1 --finish": "client rekey robot1 --keep-old",
    "service uninstall robot1.yaml": "service install robot1.yaml",
}
"""Lines that presuppose another one."""
_ANSWERS = {
    "": "success: true\n",
    "send_goal": f"# goal_id: {'ab' * 16}\naccepted: true\n",
    "get_result": "status: 4\n",
    "cancel_goal": "return_code: 0\n",
    "list_parameters": "result:\n  names: [use_sim_time]\n  prefixes: []\n",
    "get_parameters": "values:\n- type: 1\n  bool_value: false\n",
    "set_parameters": "results:\n- {successful: true, reason: ''}\n",
    "describe_parameters": "descriptors:\n- {name: controller_frequency, type: 3}\n",
}
"""Responses, by the service of an action or a node."""
_MESSAGE = PeekedMessage(b"\0\1\0\0\7\0\0\0", 8, "std_msgs/msg/Int32", "", NOW, outgoing=False)
_TOPICS = ("/scan", "/camera", "bench/tcp/transmit", "/cmd_vel", "/map", "/odom")


class Robot(Running):
    """A client that bridges all that the documents name; its nodes answer each call."""

    def __init__(self) -> None:
        routes = (
            *(route(name, key=name, outgoing=True, spec=Topic(name, "transmit")) for name in _TOPICS),
            call_route("service", "/map_server/load_map"),
            call_route("service", "/dock"),
            call_route("action", "/navigate_to_pose"),
            call_route("parameters", "/controller_server"),
        )
        super().__init__(msgspec.structs.replace(SESSION, group="hall"), routes=routes)
        name = "/camera/**"
        cameras = PatternSnapshot("cameras", "robot1", Topic(name, "transmit"), State.OK, "", True, name)
        self.now = replace(self.now, links=tuple(replace(link, patterns=(cameras,)) for link in self.now.links))
        self.peeked = [_MESSAGE] * 20

    def _execute(self, command: Command[Any], step: Callable[[str], None] | None) -> Future[Any]:
        if isinstance(command, Call):
            return self._done(_ANSWERS[command.lane], "call", command.key)
        if isinstance(command, CallWhole):
            goal = "ab" * 16 if command.lane == "send_goal" else ""
            return self._done(whole_answer(goal), "call", command.key)
        return super()._execute(command, step)


class Control(ServerEngine):
    """A server of two robots, which have a battery."""

    def __init__(self) -> None:
        super().__init__("robot1", "robot2")
        self.link("robot1", next_fingerprint=LINK.fingerprint)  # it has read its new key
        batteries = [topics(name, Topic("/battery_state", "transmit")) for name in ("robot1", "robot2")]
        self.now = replace(self.now, routes=sum(batteries, self.now.routes))
        self.peeked = [_MESSAGE] * 2


def lasts(line: str) -> bool:
    return re.search("^(arm|echo|hz|bw) |--rate", line) is not None and not re.search("--(once|count|for)", line)


def opens_console(line: str) -> bool:
    return re.fullmatch(r"\S+\.yaml|run( \S+)?|attach.*|fleet( --fleet \S+)?", line) is not None


def prepare(line: str) -> None:
    """Remove what a line writes, write what it compares, and remember the robot that it dismisses."""
    for written in re.findall(r"-o (\S+)", line) if not line.startswith("keygen") else Path().glob("*key*"):
        Path(written).unlink(missing_ok=True)
    if "dismiss" in line:
        from rsb_extras.fleet.fleet import Memory, Remembered, memory_path

        memory = Memory(memory_path())
        memory.saw(Remembered("control", "robot9", NOW - 3600))
        memory.save()
    if line.startswith(("param diff", "param load")):
        Path(line.rsplit(maxsplit=1)[-1]).write_text("/**: {ros__parameters: {use_sim_time: false}}\n")
    if line.startswith("audit"):
        from rsb_extras.audit.tests.written import write_sides

        near, far = line.split()[1:3]
        write_sides(near, far, ("/scan", "/robots/r1/scan", "/camera/image", "/cmd_vel", "/tf"))


def run(line: str) -> int:
    if line.startswith("fleet edit"):
        line += " --settle 0.1"  # instead of 10 s
    try:
        arguments = parsed(line)
        code: int = arguments.command(arguments)
    except KeyboardInterrupt:
        return INTERRUPTED
    except SystemExit as ended:
        return int(ended.code or 0)
    return code


@pytest.fixture
def consoles(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The consoles that a line opens. They don't draw: tests/console does."""
    opened: list[object] = []
    replaced.CAN_DRAW.set(monkeypatch, lambda _: True)
    replaced.RUN_APP.set(monkeypatch, lambda app, **_: opened.append(app))
    return opened


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files of the documents, in an operator's folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("XDG_STATE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    if "service" not in MISSING:
        from rsb_extras.service.tests.service_places import SYSTEM_UNITS

        SYSTEM_UNITS.set(monkeypatch, tmp_path / "system")
    for name in ("robot1.key", "key.txt"):
        write_key(tmp_path / name)
    for name in ("robot1.yaml", "robot2.yaml"):
        save(msgspec.structs.replace(SESSION, key_file="robot1.key"), tmp_path / name)
    server = msgspec.structs.replace(
        Control().session, clients=(Client("robot1"), Client("robot3", "r3.key")), key_file="robot1.key"
    )
    for name in ("control.yaml", "control-pc.yaml"):
        save(server, tmp_path / name)
    (tmp_path / "bringup.yaml").write_text(BRINGUP)
    (tmp_path / "bridge.yaml").write_text(DOMAINS)
    for name in ("robot.json5", "control.json5"):
        role = "connect" if name == "robot.json5" else "listen"
        (tmp_path / name).write_text(f'{{plugins: {{ros2dds: {{}}}}, {role}: {{endpoints: ["tcp/10.0.0.1:7447"]}}}}')
    (tmp_path / "setup.bash").touch()
    return tmp_path


@pytest.fixture
def serve(machine: Machine, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    monkeypatch.setenv("XDG_RUNTIME_DIR", machine.environ["XDG_RUNTIME_DIR"])

    def serve(line: str) -> None:
        engine: ScriptedEngine = Control() if line.startswith(("fleet", "client", "bench control")) else Robot()
        server: ControlServer = machine.serve(
            engine, file=folder / f"{engine.session.name}.yaml", on_stop=lambda: Thread(target=server.close).start()
        )

    return serve


@pytest.fixture
def press_keys(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Has an operator answer yes; and press Ctrl-C once a line has printed something, if it lasts until then."""

    def press(line: str) -> None:
        surroundings.set_stdin(monkeypatch, "y\n", is_terminal=True)
        if "look" not in line.split():  # which would draw on the whole screen
            surroundings.print_to_terminal(monkeypatch)
        if not lasts(line):
            return
        write = replaced.SHELL_PRINT.value

        def written(text: str) -> None:
            write(text)
            signal.raise_signal(signal.SIGINT)

        replaced.SHELL_PRINT.set(monkeypatch, written)

    return press


RUN_HERE = {each.text: each for each in FOUND if each.text not in _ELSEWHERE and not lacks_arguments(each)}.values()
"""Each line once, wherever it stands."""


def over_zenoh(line: Line) -> bool:
    return "--fleet" in line.words and line.words[0] != "demo"


def check(line: str, capsys: pytest.CaptureFixture[str], consoles: list[object]) -> None:
    assert run(line) == (INTERRUPTED if lasts(line) else OK), capsys.readouterr().err
    assert bool(consoles) is opens_console(line)


@pytest.mark.parametrize("line", [each for each in RUN_HERE if not over_zenoh(each)], ids=ids)
def test_it_works(
    line: Line,
    serve: Callable[[str], None],
    press_keys: Callable[[str], None],
    consoles: list[object],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = _COMPLETE.get(line.text, line.text)
    prepare(text)
    serve(text)
    press_keys(text)
    constants.FIGURES_EVERY.set(monkeypatch, 0.05)
    if line.words[0] == "bench":
        replaced.BENCH_MEASURE.set(monkeypatch, lambda *_: OK)  # the feature's own tests measure
    if text in _BEFORE:
        assert run(_BEFORE[text]) == OK
    check(text, capsys, consoles)


@pytest.mark.parametrize("line", [each for each in RUN_HERE if over_zenoh(each)], ids=ids)
def test_it_works_over_zenoh(
    line: Line,
    folder: Path,
    press_keys: Callable[[str], None],
    consoles: list[object],
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("zenoh", reason="needs Zenoh")
    from rsb_extras.operators.tests.zenoh_fleet import Fleet

    with contextlib.closing(Fleet(folder)) as fleet:
        fleet.add("robot1", Robot())
        fleet.write_file("anna", ANNA).rename("harbour.yaml")
        press_keys(line.text)
        check(line.text, capsys, consoles)


def test_what_cannot_run_here_is_run_by_test() -> None:
    assert {line.text for line in FOUND} >= set(_ELSEWHERE)
    for file, name in _ELSEWHERE.values():
        assert f"\ndef {name}(" in (_ROOT / "tests" / file).read_text(encoding="utf-8")


def test_each_command_that_is_named_is_run() -> None:
    named = {line.words[0] for line in FOUND if lacks_arguments(line)}
    assert named <= {word for line in RUN_HERE for word in line.words}
