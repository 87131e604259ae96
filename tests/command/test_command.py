"""The installed `rsb-console`, as a process: what it prints, where, and how it exits."""

import json
import os
import pty
import select
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import pytest
from tests.support import replaced, surroundings
from tests.support.captured import own_lines
from tests.support.commands import Ran, rsb_console
from tests.support.long import long
from tests.support.wording import says

from rsb_bridge.config.advice import Advice
from rsb_bridge.config.decoding import Hint, ValueMistake
from rsb_bridge.config.files import FileRefused
from rsb_bridge.config.keys import KeyFileProblem, KeyWarning, write_key
from rsb_bridge.config.validation import SessionMistake
from rsb_bridge.config.yaml_text import YamlMistake
from rsb_bridge.model.transports import Protocol
from rsb_console.command import target
from rsb_console.command.argument_values import ValueProblem
from rsb_console.command.check import SessionCheckText
from rsb_console.command.local_commands import LocalText
from rsb_console.command.shell import CommandText

COMMAND = str(Path(sys.executable).with_name("rsb-console"))
MOST_MODULES = 264
"""Half of what the console takes; Python itself takes a third.

Of the standard library only what has a public name counts: what is below that differs from Python to Python.
"""
UNUSED_BY_BRIDGES = {"dbus_fast", "mcap", "numpy", "prometheus_client", "rich", "textual", "zenoh"}
COUNTS_MODULES = """\
import atexit

def count():
    top = {name: name.partition(".")[0] for name in sys.modules if not name.startswith("_")}
    print("modules", len({at if at in sys.stdlib_module_names else name for name, at in top.items()}))

atexit.register(count)
"""
SESSION = """\
name: robot1
role: client
server_ip: 127.8.0.1
server_port: 49152
key_file: key.txt
topics:
  - {topic: /scan, direction: transmit, protocol: udp, max_rate: 5}
"""
CLIENT_WITHOUT_KEY = """\
name: robot1
role: client
server_ip: 127.8.0.1
server_port: 7060
key_file: robot1.key
topics: [{topic: /scan, direction: transmit}]
"""

pytestmark = pytest.mark.usefixtures("folder")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    Path("robot1.yaml").write_text(SESSION)
    return tmp_path


def process(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run([COMMAND, *arguments], capture_output=True, text=True, timeout=120, check=False, **options)


def with_first(before: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a Python that first does something else."""
    script = script_of(before, arguments)
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)


def script_of(before: str, arguments: tuple[str, ...]) -> str:
    return f"import sys\n{before}\nfrom rsb_console.cli import main\nsys.exit(main({list(arguments)!r}))"


@pytest.mark.parametrize("arguments", [("--help",), ("keygen", "--force"), ("check", "robot1.yaml")])
def test_it_answers_at_once_without_ros_and_textual(arguments: tuple[str, ...]) -> None:
    rsb_console("keygen")
    blocked = "for name in ('rclpy', 'textual', 'rich', 'dbus_fast', 'asyncio'): sys.modules[name] = None"
    run = with_first(COUNTS_MODULES + blocked, *arguments)
    assert run.returncode == 0
    assert int(run.stdout.rpartition("modules")[2]) < MOST_MODULES  # what it takes to start is what it imports


@pytest.mark.parametrize("arguments", [("--version",), ("--debug", "--version")])
def test_version_loads_neither_arguments_nor_features(arguments: tuple[str, ...]) -> None:
    run = with_first("import atexit; atexit.register(lambda: print(*sys.modules))", *arguments)
    version, modules = run.stdout.splitlines()
    assert version.startswith("rsb-console ")
    loaded = set(modules.split())
    own = {each for each in loaded if each.startswith("rsb_") and each.count(".") > 1}
    of_console = "rsb_console.command.shell", "rsb_console.notation.ascii_signs"
    assert own == {*of_console, *(f"rsb_bridge.model.{each}" for each in ("limits", "text", "wording"))}
    assert not {"argparse", "msgspec", "rsb_bridge.feature"} & loaded


@pytest.mark.parametrize(("closed", "name", "code"), [(">&-", "robot1", 0), ("2>&-", "none", 2)])
def test_closed_outputs_change_nothing_but_what_is_said(closed: str, name: str, code: int) -> None:
    rsb_console("keygen")
    run = subprocess.run(["sh", "-c", f'exec "$0" check {name}.yaml {closed}', COMMAND], timeout=120, check=False)
    assert run.returncode == code


def test_check_says_what_would_be_bridged_and_warns() -> None:
    run = rsb_console("check", "robot1.yaml")
    assert run.returncode == 3, "it would not start"
    assert "client robot1 to 127.8.0.1 port 49152" in run.stdout
    assert "transmit /scan over udp: type auto, qos auto, at most 5 Hz" in run.stdout
    assert f"encryption on, {SessionCheckText.PREFIX_IF_USED(name='robot1')}" in run.stdout
    assert f"warning: {KeyFileProblem.NO_SUCH_FILE(path='key.txt')}" in run.stdout
    rsb_console("keygen")
    run = rsb_console("check", "robot1.yaml")
    assert run.returncode == 0
    assert "warning" not in run.stdout
    Path("key.txt").chmod(0o644)
    run = rsb_console("check", "robot1.yaml")
    assert run.returncode == 0, "a warning is no failure"
    assert says(run.stdout, KeyWarning.READABLE, path="key.txt", mode="0644")


def test_check_tells_owner_and_age_of_keys() -> None:
    for name in ("old.key", "new.key"):
        rsb_console("keygen", name)
    Path("pc.yaml").write_text(
        "name: pc\nrole: server\nserver_ip: 0.0.0.0\nserver_port: 4000\nclients:\n"
        "  - {name: a, key_file: old.key, next_key_file: new.key}\n"
    )
    run = rsb_console("check", "pc.yaml")
    assert (run.returncode, "warning" in run.stdout) == (0, False)
    lines = [line for line in run.stdout.splitlines() if line.startswith("key ")]
    assert says(lines[0], SessionCheckText.KEY, file="old.key", users="a")
    assert says(lines[1], SessionCheckText.KEY, file="new.key", users="a (next)")
    assert all("(just now)" in line or "minute" in line for line in lines)
    long_ago = time.time() - 30 * 86400
    os.utime("new.key", (long_ago, long_ago))
    run = rsb_console("check", "pc.yaml")
    assert (run.returncode, says(run.stdout, KeyWarning.TWO_FOR_LONG, name="a")) == (0, True)
    Path("new.key").write_bytes(Path("old.key").read_bytes())
    run = rsb_console("check", "pc.yaml")
    assert (run.returncode, says(run.stdout, KeyWarning.SAME_NEXT, name="a")) == (0, True)
    Path("new.key").unlink()
    run = rsb_console("check", "pc.yaml")
    assert (run.returncode, f"warning: {KeyFileProblem.NO_SUCH_FILE(path='new.key')}" in run.stdout) == (3, True)


def test_check_looks_once_at_each_key() -> None:
    """Its output and its exit code agree, even if the file changes meanwhile."""
    rsb_console("keygen")
    heard = "sys.addaudithook(lambda name, what: name == 'open' and str(what[0]) == 'key.txt' and print('opened'))"
    run = with_first(heard, "check", "robot1.yaml")
    assert (run.returncode, run.stdout.count("opened")) == (0, 1)


@pytest.mark.parametrize("second", ["key.txt", "copy.txt", "gone.txt"])
def test_check_refuses_clients_that_share_a_key(second: str) -> None:
    rsb_console("keygen")
    Path("copy.txt").write_bytes(Path("key.txt").read_bytes())
    server = "name: pc\nrole: server\nserver_ip: 0.0.0.0\nserver_port: 4000\nkey_file: {first}\n"
    first = "gone.txt" if second == "gone.txt" else "key.txt"
    Path("pc.yaml").write_text(
        server.format(first=first) + f"clients: [{{name: a}}, {{name: b, key_file: {second}}}]\n"
    )
    run = rsb_console("check", "pc.yaml")
    assert run.returncode == 2
    assert says(run.stderr, KeyFileProblem.SHARED, owners=KeyFileProblem.ONE_KEY(names="a and b"))
    Path("pc.yaml").write_text(Path("pc.yaml").read_text() + "shared_keys: true\n")
    assert rsb_console("check", "pc.yaml").returncode == (3 if second == "gone.txt" else 0)


def test_check_lists_operators_and_refuses_shared_keys() -> None:
    for name in ("key.txt", "anna.key"):
        rsb_console("keygen", name)
    Path("pc.yaml").write_text(
        "name: pc\nrole: server\nserver_ip: 0.0.0.0\nserver_port: 4000\nkey_file: key.txt\n"
        "operators: [{name: anna, key_file: anna.key}]\n"
    )
    run = rsb_console("check", "pc.yaml")
    assert (run.returncode, run.stderr) == (0, "")
    assert says(run.stdout, SessionCheckText.KEY, file="anna.key", users="operator anna, who may look")
    Path("anna.key").write_bytes(Path("key.txt").read_bytes())
    run = rsb_console("check", "pc.yaml")
    assert (run.returncode, "operator anna" in run.stderr) == (2, True)
    Path("anna.key").unlink()
    run = rsb_console("check", "pc.yaml")
    assert (run.returncode, f"warning: {KeyFileProblem.NO_SUCH_FILE(path='anna.key')}" in run.stdout) == (3, True)


def test_check_lists_rights_of_clients_and_moving_topics() -> None:
    Path("fleet.yaml").write_text(
        "name: pc\nrole: server\nserver_ip: 0.0.0.0\nserver_port: 4000\nuse_encryption: false\nports: [12001]\n"
        "clients:\n"
        "  - {name: open}\n  - {name: named, use_name: true}\n"
        "  - {name: still, deny: [/cmd_vel, /joint_*, /joy, '*/commands', /tf, /clock]}\n"
        "  - {name: visitor, allow: [/camera/*, /tf], deny: [/camera/raw]}\n"
        "  - name: driver\n"
        "    allow: [{topics: /cmd_vel, may: publish, protocol: udp, max_rate: 10}, {topics: /odom, may: read}]\n"
        "  - {name: deaf, deny: [{topics: /*, may: read}, {topics: /cmd_vel, may: publish}]}\n"
    )
    lines = rsb_console("check", "fleet.yaml").stdout.splitlines()
    table = [line.split() for line in lines[lines.index(next(line for line in lines if "may do here" in line)) + 1 :]]
    anything = ["tcp,", "udp", "any", "12001"]
    assert ["open", "publish,", "read", "all", *anything] in table
    assert ["named", "publish,", "read", "/named/*", *anything] in table
    assert ["visitor", "publish,", "read", "/camera/*", "and", "/tf,", "not", "/camera/raw", *anything] in table
    assert ["driver", "publish", "/cmd_vel", "udp", "10", "Hz", "12001"] in table
    assert ["driver", "read", "/odom", *anything] in table
    assert ["deaf", "publish", "all,", "not", "/cmd_vel", *anything] in table
    assert ["deaf", "read", "all,", "not", "/*", *anything] in table
    assert [line.strip() for line in lines if says(line, SessionCheckText.MAY_MOVE)] == [
        SessionCheckText.MAY_MOVE(peer="open", names="/cmd_vel, /joint_*, /joy, */commands, /tf, /clock"),
        SessionCheckText.MAY_MOVE(peer="visitor", names="/tf"),
        SessionCheckText.MAY_MOVE(peer="driver", names="/cmd_vel"),
        SessionCheckText.MAY_MOVE(peer="deaf", names="/joint_*, /joy, */commands, /tf, /clock"),
    ]
    assert [line.strip() for line in lines if says(line, SessionCheckText.MAY_ACT)] == [
        SessionCheckText.MAY_ACT(peer=name, names="any service, action and parameter")
        for name in ("open", "still", "deaf")
    ]
    assert f"  {SessionCheckText.NODES_MAY_STOP(topic='/shutdown')}" in lines
    client = rsb_console("check", "robot1.yaml").stdout
    assert ["the", "server", "publish", "nothing", "-", "-"] in [line.split() for line in client.splitlines()]
    assert ["the", "server", "read", "all", "tcp,", "udp", "any"] in [line.split() for line in client.splitlines()]
    assert not says(client, SessionCheckText.MAY_MOVE)
    assert says(client, SessionCheckText.SERVER_MAY_STOP)
    assert not says(client, SessionCheckText.OWN_PORTS)


def test_check_leaves_out_nothing_that_a_topic_says() -> None:
    Path("full.yaml").write_text(
        SESSION.replace(
            "max_rate: 5", "max_rate: 5, expected_rate: 4, compression: zstd, stale_after: 0, remote_topic: /far"
        )
    )
    (line,) = [line for line in rsb_console("check", "full.yaml").stdout.splitlines() if "/scan" in line]
    for words in ("zstd compression", "/far on the server", "at most 5 Hz", "expected 4 Hz", "never stale"):
        assert words in line
    Path("fleet.yaml").write_text(
        "name: pc\nrole: server\nserver_ip: 0.0.0.0\nserver_port: 4000\nkey_file: key.txt\nuse_name: true\n"
        "clients: [{name: robot1}, {name: robot2, use_name: false, deny: [/map]}]\n"
    )
    fleet = rsb_console("check", "fleet.yaml").stdout
    assert "prefix /<name>" in fleet
    assert "accepts robot1: everything\n" in fleet
    assert "accepts robot2: everything, not /map, no prefix" in fleet


def test_invalid_key_file_is_warned_of_never_shown() -> None:
    rsb_console("keygen")
    key = Path("key.txt").read_text().strip()
    refused = rsb_console("check", "key.txt")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == f"rsb-console: key.txt: {YamlMistake.KEY_FILE()}\n"
    Path("key.txt").unlink()
    os.mkfifo("key.txt")
    run = rsb_console("check", "robot1.yaml")
    assert says(
        run.stdout, SessionCheckText.KEY_MISSING, problem=KeyFileProblem.NOT_A_FILE(path="key.txt", kind="a FIFO")
    )
    assert key not in run.stdout + run.stderr
    problem = FileRefused.NOT_A_FILE(kind="a FIFO")
    assert says(rsb_console("keygen", "--force").stderr, KeyFileProblem.NOT_WRITTEN, problem=problem)


def test_check_warns_of_types_that_are_not_installed() -> None:
    rsb_console("keygen")
    Path("types.yaml").write_text(f"{SESSION}  - {{topic: /odd, direction: transmit, type: std_msgs/msg/Strin}}\n")
    run = rsb_console("check", "types.yaml")
    assert run.returncode == 0
    warnings = [line for line in run.stdout.splitlines() if line.startswith("warning: ")]
    assert len(warnings) == 1
    assert says(warnings[0], Advice.TYPE_NOT_INSTALLED, type="std_msgs/msg/Strin")
    assert "topic /odd, type: " in warnings[0]


@pytest.mark.parametrize("arguments", [("check",), ("run", "--no-ui"), ("run",), ()])
def test_bad_session_file_is_refused_with_its_lines(arguments: tuple[str, ...]) -> None:
    Path("bad.yaml").write_text(SESSION.replace("udp", "tpc").replace("49152", "0"))
    run = rsb_console(*arguments, "bad.yaml")
    assert run.returncode == 2
    assert run.stdout == ""
    misfit = ValueMistake.MISFIT(
        value="'tpc'", expected=f"one of {', '.join(get_args(Protocol))}", hint=Hint.DID_YOU_MEAN(name="tcp")
    )
    assert run.stderr.splitlines()[1:] == [
        f"bad.yaml:4: server_port: {SessionMistake.PORT_MISSING(kind='port', range='1 to 65535')}",
        f"bad.yaml:7: topic /scan, protocol: {misfit}",
    ]
    assert rsb_console(*arguments, "none.yaml").stderr == "rsb-console: none.yaml: no such file\n"


def test_keygen_makes_key_txt_and_never_prints_it() -> None:
    run = rsb_console("keygen")
    key = Path("key.txt").read_text().strip()
    assert run.returncode == 0
    assert says(run.stdout, LocalText.NEW_KEY, path="key.txt")
    assert key not in run.stdout + run.stderr
    again = rsb_console("keygen")
    assert again.returncode == 1
    assert says(again.stderr, KeyFileProblem.EXISTS, path="key.txt")
    assert Path("key.txt").read_text().strip() == key
    assert rsb_console("keygen", "--force").returncode == 0
    assert Path("key.txt").read_text().strip() != key
    assert rsb_console("keygen", "robot1.key").returncode == 0
    assert Path("robot1.key").stat().st_mode & 0o777 == 0o600


def test_check_as_json_names_effects_and_missing_key(ran: Callable[..., Ran], tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(CLIENT_WITHOUT_KEY)
    without = ran("check", str(path), "--json")
    assert (without.code, without.json["ok"], without.json["role"]) == (3, False, "client")
    assert "robot1.key" in without.json["error"]
    write_key(tmp_path / "robot1.key")
    found = ran("check", str(path), "--json")
    assert (found.code, found.json["ok"], found.json["mistakes"]) == (0, True, [])
    assert any("/scan" in line for line in found.json["effects"])


def test_check_as_json_places_mistakes(ran: Callable[..., Ran], tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(CLIENT_WITHOUT_KEY.replace("7060", "x"))
    found = ran("check", str(path), "--json")
    assert (found.code, found.json["ok"]) == (2, False)
    assert [(each["line"], each["key"]) for each in found.json["mistakes"]] == [(4, "server_port")]


@pytest.mark.parametrize("arguments", [(), ("--debug",), ("run",), ("robot1.yaml",), ("--readonly", "robot1.yaml")])
def test_the_console_is_refused_without_a_terminal(arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    with Path(os.devnull).open() as nothing:
        surroundings.set_stdin(monkeypatch, nothing)
        run = rsb_console(*arguments)
    assert run.returncode == 2
    assert says(run.stderr, LocalText.NO_TERMINAL)
    assert "--no-ui" in run.stderr


def test_the_console_is_refused_on_a_dumb_terminal() -> None:
    ours, theirs = pty.openpty()
    try:
        run = subprocess.run(
            [COMMAND, "robot1.yaml"],
            stdin=theirs,
            stdout=theirs,
            stderr=subprocess.PIPE,
            env=os.environ | {"TERM": "dumb"},
            timeout=120,
            check=False,
        )
    finally:
        os.close(ours)
        os.close(theirs)
    assert run.returncode == 2
    assert says(run.stderr.decode(), LocalText.PLAIN_TERMINAL, instead="rsb-console run --no-ui robot1.yaml")


def test_line_that_was_typed_ahead_answers_no_question(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    with open(theirs) as terminal:  # noqa: PTH123 -- a descriptor
        surroundings.set_stdin(monkeypatch, terminal)
        surroundings.print_to_terminal(monkeypatch)
        os.write(ours, b"y\n")
        assert select.select([terminal], [], [], 60.0)[0]
        replaced.TARGET_PRINT_LINE.set(monkeypatch, lambda _: os.write(ours, b"n\n"))
        assert not target.agreed("Drop the old key?")
    os.close(ours)


def test_bad_arguments_are_refused_in_words() -> None:
    not_seconds = ValueProblem.NOT_ABOVE_0
    for arguments, words in [
        (("chekc", "robot1.yaml"), CommandText.MISSPELT(word="chekc", command="check")),
        (("run", "--no-ui"), LocalText.SESSION_MISSING()),
        (("run", "--log-format", "xml", "robot1.yaml"), "invalid choice: 'xml'"),
        (
            ("run", "--status-every", "soon", "robot1.yaml"),
            f"--status-every: {not_seconds(text='soon', noun='number of seconds')}",
        ),
        (
            ("run", "--status-every", "nan", "robot1.yaml"),
            f"--status-every: {not_seconds(text='nan', noun='number of seconds')}",
        ),
        (("check",), "the following arguments are required: SESSION"),
    ]:
        run = rsb_console(*arguments)
        assert run.returncode == 2
        assert words in run.stderr
        assert "Traceback" not in run.stderr


def test_command_of_a_missing_feature_names_it() -> None:
    without = "import importlib.metadata as metadata; metadata.entry_points = lambda **_: ()"
    run = with_first(without, "doctor", "robot1.yaml")
    assert run.returncode == 2
    assert CommandText.OF_FEATURE(word="doctor", feature="doctor") in run.stderr


def test_session_named_like_command_is_reached_by_path() -> None:
    Path("checks").write_text(SESSION.replace("udp", "tpc"))
    assert "checks:7: topic /scan, protocol" in rsb_console("checks").stderr


def test_unforeseen_failure_is_one_line_and_log(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def check(_: object) -> int:
        raise RuntimeError("sprocket")

    replaced.CHECK_SESSION.set(monkeypatch, check)
    run = rsb_console("check", "robot1.yaml", may_crash=True)
    log = folder / "state" / "rsb-console" / "crash.log"
    assert run.returncode == 1
    assert run.stderr == f"rsb-console: unexpected RuntimeError: sprocket (details: {log})\n"
    assert "Traceback" in log.read_text()
    assert stat.S_IMODE(log.stat().st_mode) == 0o600
    for arguments in (("--debug", "check", "robot1.yaml"), ("check", "--debug", "robot1.yaml")):
        assert "Traceback" in rsb_console(*arguments, may_crash=True).stderr
    (folder / "state").rename(folder / "elsewhere")
    (folder / "state").write_text("not a folder")
    stderr = rsb_console("check", "robot1.yaml", may_crash=True).stderr
    assert says(stderr, CommandText.CRASHED_WITHOUT_LOG, log=log)
    assert stderr.count("\n") == 1


def test_an_interrupt_is_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command raises what Ctrl-C raises: no command here runs long enough to be hit by a real one."""

    def check(_: object) -> int:
        raise KeyboardInterrupt

    replaced.CHECK_SESSION.set(monkeypatch, check)
    run = rsb_console("check", "robot1.yaml", may_crash=True)
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "")


def test_a_reader_that_left_gets_no_traceback() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        run = subprocess.run(
            [COMMAND, "check", "robot1.yaml"], stdout=writer, stderr=subprocess.PIPE, timeout=120, check=False
        )
    finally:
        os.close(writer)
    assert (run.returncode, run.stderr) == (1, b"")


def test_names_outside_the_terminals_encoding_are_escaped() -> None:
    Path("robot1.yaml").write_text(SESSION.replace("name: robot1", "name: röbot"), encoding="utf-8")
    rsb_console("keygen")
    run = process("check", "robot1.yaml", env=os.environ | {"PYTHONIOENCODING": "ascii"})
    assert run.returncode == 0
    assert r"client r\xf6bot" in run.stdout


def started_headless(before: str, *arguments: str) -> subprocess.Popen[str]:
    """Start the command in a Python that first does something else, and return it once it has printed a line."""
    return subprocess.Popen(
        [sys.executable, "-c", script_of(before, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_headless_bridge_loads_only_what_it_uses() -> None:
    """What it has loaded it keeps for as long as it runs (bench/README.md, "Memory of a side")."""
    rsb_console("keygen")
    before = "import atexit; atexit.register(lambda: print(*sys.modules))"
    with started_headless(before, "run", "--no-ui", "--status-every", "0.1", "robot1.yaml") as run:
        assert run.stdout
        assert any("status" in line for line in run.stdout), "it ended before it was up"
        run.send_signal(signal.SIGTERM)
        output, _ = run.communicate(timeout=120)
    loaded = set(output.splitlines()[-1].split())
    assert {"rclpy", "rsb_bridge.link.link"} <= loaded
    assert not UNUSED_BY_BRIDGES & loaded


@pytest.mark.parametrize("number", [*long(signal.SIGINT), signal.SIGTERM])
def test_signal_while_engine_starts_ends_it_cleanly(number: signal.Signals) -> None:
    """The engine's start says when it begins, so that the signal meets it."""
    rsb_console("keygen")
    before = (
        "from rsb_bridge.engine import Engine\nstart = Engine.start\n"
        "def told(self):\n    print('starting', flush=True)\n    start(self)\nEngine.start = told"
    )
    with started_headless(before, "run", "--no-ui", "robot1.yaml") as run:
        assert run.stdout
        assert run.stdout.readline() == "starting\n"
        run.send_signal(number)
        output, errors = run.communicate(timeout=120)
    assert (run.returncode, own_lines(errors)) == (0, [])
    assert f"stopping: {number.name}" in output


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_during_imports_is_quiet(number: signal.Signals, code: int) -> None:
    """The first import that is not small says when it begins, and takes long; what is open is closed as usual."""
    before = (
        "import time\nclass Slow:\n    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'argparse':\n            print('importing', flush=True); time.sleep(20)\n"
        "sys.meta_path.insert(0, Slow())"
    )
    with started_headless(before, "check", "robot1.yaml") as run:
        assert run.stdout
        assert run.stdout.readline() == "importing\n"
        run.send_signal(number)
        assert run.communicate(timeout=120) == ("", "")
    assert run.returncode == code


def test_more_interrupts_while_stopping_change_nothing() -> None:
    rsb_console("keygen")
    options = ("--log-format", "json", "--status-every", "3600")
    with started_headless("", "run", "--no-ui", *options, "robot1.yaml") as run:
        assert run.stdout
        lines = [json.loads(run.stdout.readline())]
        while run.poll() is None:
            run.send_signal(signal.SIGINT)
            time.sleep(0.01)  # a hand on Ctrl-C
        output, errors = run.communicate(timeout=120)
    assert (run.returncode, own_lines(errors)) == (0, [])
    lines += [json.loads(line) for line in output.splitlines()]
    assert [line["text"] for line in lines if line["code"] == "engine.stopping"] == ["stopping: SIGINT"]
    assert all({"time", "level", "code", "text"} <= line.keys() and "number" not in line for line in lines)
