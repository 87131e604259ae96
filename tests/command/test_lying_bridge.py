"""Root's commands ask a service that lies in every field of every answer."""

from __future__ import annotations

import shlex
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest
from tests.support import constants, surroundings
from tests.support.commands import parser_and_commands, rsb_console, subcommands_of
from tests.support.long import long_cases
from tests.support.lying import LyingBridge, lies
from tests.support.other_user import OTHER, files_in, folder_for_all, only_root, theirs

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.session import Client, Session
from rsb_bridge.model.text import is_clean
from rsb_console.command.shell import FAILURE, NOT_RUNNING, OK, USAGE

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = only_root
SCAN, SERVICE = "/robot2/scan", "/robot1/set_mode"
ASKING = [
    "status", "status --json", "topics", "topics --json", "topics --available", "add /new transmit",
    f"edit {SCAN} max_rate=5", f"remove {SCAN}", f"pause {SCAN}", f"resume {SCAN}", f"ack {SCAN}", "ack robot1",
    f"arm {SCAN}", f"arm {SCAN} --ask", f"arm {SCAN} --take", f"disarm {SCAN}", "retry", "restart", "reload",
    "reload --dry-run --json", "save", "events", "events --json", "report", "report --json", "report --csv", "record",
    "record --output mine.mcap", "wait --for linked --timeout 1", f"wait --for flowing {SCAN} --timeout 1",
    "wait --for stopped --timeout 1", f"echo {SCAN} --once --timeout 1", f"look {SCAN} --once --timeout 1",
    f"look {SCAN} --once --timeout 1 --output mine.png", f"pub {SCAN} --template", f"pub {SCAN} '' --count 1",
    f"hz {SCAN} --count 1 --for 1", f"bw {SCAN} --count 1 --for 1", f"info {SCAN}", f"info {SCAN} --json", "stop",
    f"call {SERVICE} {{}}", "client list", "client list pc.yaml", "client add robot3",
    "client add pc.yaml robot3", "client show robot1", "client rekey robot1",
    "client rekey pc.yaml robot1", "client rekey pc.yaml robot1 --keep-old", "client rekey robot1 --finish --yes",
    "client remove robot1", "client remove pc.yaml robot1", "bench --quick --seconds 1", "doctor pc.yaml",
    "record list", "record list robot1 --json", "record get robot1 '' --no-wait", "record get robot1 '' --from 1",
    "record get robot1 x", "record get robot1 x --json", "record cancel ''", "record missing x",
    "nodes", "nodes --json", "units", "units --json", "units restart '' --yes",
    "lifecycle", "lifecycle --json", "lifecycle up '' --yes",
    "component list", "component list --json", "component load '' a a::B --yes", "component unload '' '' --yes",
    "param list", "param list --json", "param list /n --link robot1", "param list /n --link robot1 --json",
    "param get /n '' --link robot1", "param describe /n --link robot1", "param set /n '' 1 --link robot1 --yes",
    "param dump /n --link robot1",
    "param dump /n --link robot1 --output mine.yaml", "param diff /n nav.yaml --link robot1",
    "param load /n nav.yaml --link robot1 --yes",
    "fleet --json --seconds 1", "fleet dismiss --all", "fleet exec --all -- status",
    f"fleet edit --all {SCAN} max_rate=5 --yes",
]  # fmt: skip
"""Each command that asks a bridge."""
ASKS_NOBODY = {"check", "keygen", "import", "bt-scan", "demo", "service", "audit", "completion", "play", "review"}
HAS_A_SCREEN = {"attach", "run"}
ASKS_OFTEN = {"mcp"}  # each of its tools runs one of the commands that ask


class Bed(NamedTuple):
    """Folders of a test.

    Attributes:
        own: of what nobody may touch.
        work: in which commands run.
        state: of what the program keeps.
    """

    own: Path
    work: Path
    state: Path


@pytest.fixture
def bed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bed]:
    with folder_for_all() as folder:
        bed = Bed(*(folder / each for each in Bed._fields))
        for each in bed:
            each.mkdir(mode=0o700)
        save(_server(), bed.work / "pc.yaml")
        save(_server(), bed.own / "pc.yaml")
        (bed.work / "nav.yaml").write_text("/n: {ros__parameters: {a: 1}}\n")
        write_key(bed.work / "robot1.key")
        write_key(bed.own / "robot1.key")
        for name in ("XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME", "XDG_DATA_HOME", "HOME"):
            monkeypatch.setenv(name, str(bed.state))
        for name in ("STATE_DIRECTORY", "RUNTIME_DIRECTORY"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder / "run"))
        monkeypatch.chdir(bed.work)
        surroundings.set_stdin(monkeypatch, "")
        yield bed


def _server() -> Session:
    clients = (Client("robot1", "robot1.key"),)
    return Session(name="pc", role="server", server_ip="10.0.0.20", server_port=49152, clients=clients)


@pytest.fixture
def socket_path(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The path of a control socket of a service, which is the only one that is found."""
    folder = bed.own.parent / "services"
    folder.mkdir(mode=0o700)
    constants.SERVICES_SOCKETS.set(monkeypatch, theirs(folder))
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(folder))
    return folder / "robot1.sock"


QUICK = [
    *[("escapes", line) for line in ASKING if line.split()[0] not in ("bench", "bw", "hz", "stop")],
    *[("path", line) for line in ASKING if line.startswith(("client", "record"))],
]


@pytest.mark.parametrize(
    ("kind", "line"), [*QUICK, *long_cases(*[case for case in product(lies(""), ASKING) if case not in QUICK])]
)
def test_lies_change_no_file_and_no_terminal(line: str, kind: str, bed: Bed, socket_path: Path) -> None:
    lie = lies(str(bed.own / "pc.yaml"))[kind]
    before, at_work = files_in(bed.own), files_in(bed.work)
    with LyingBridge(socket_path, lie, uid=OTHER) as bridge:
        ran = rsb_console(*shlex.split(line))
    assert bridge.heard
    assert ran.returncode in (OK, FAILURE, USAGE, NOT_RUNNING), ran
    for text in (ran.stdout, ran.stderr):
        assert is_clean(text.replace("\r\n", "").replace("\n", "").replace("\t", "")), repr(text[:2000])
    assert files_in(bed.own) == before
    after = files_in(bed.work)
    changed = {name for name in {*after, *at_work} if after.get(name) != at_work.get(name)}
    assert {Path(each).name for each in changed} <= _may_change(line)


def _may_change(line: str) -> set[str]:
    """Return the names of files in the working folder that a command's own arguments have it change."""
    if line.startswith("client") and "pc.yaml" in line:
        return {"pc.yaml", "pc.yaml~", "robot1.key", "robot3.key", "robot1-next.key"}
    return {"mine.png", "mine.yaml"}


def test_no_command_is_forgotten() -> None:
    known = {line.split()[0] for line in ASKING} | ASKS_NOBODY | HAS_A_SCREEN | ASKS_OFTEN
    assert known == {*subcommands_of(parser_and_commands()[0])}
    for group in ("client", "param", "component"):
        named = {line.split()[1] for line in ASKING if line.startswith(f"{group} ")}
        assert named == {*subcommands_of(subcommands_of(parser_and_commands()[0])[group])}
