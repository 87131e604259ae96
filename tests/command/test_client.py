"""`rsb-console client`: written files, commands to a running server, and refusals."""

from __future__ import annotations

import dataclasses
import json
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, get_args

import pytest
from msgspec.structs import replace
from tests.command.client_helpers import TEXT, path
from tests.console.scripted import LINK, ScriptedEngine
from tests.support import replaced, surroundings
from tests.support.wording import says

from rsb_bridge.config.decoding import ValueMistake
from rsb_bridge.config.keys import KeyFileProblem, fingerprint, read_key, write_key
from rsb_bridge.config.session_changes import ClientProblem
from rsb_bridge.config.session_file import SavingProblem, dump, load, parse, save
from rsb_bridge.config.validation import SessionMistake
from rsb_bridge.feature import Feature
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Client, May, Session, Topic
from rsb_bridge.model.snapshot import Event, Level, State
from rsb_console.command.client_command import ClientCommandProblem, ClientEffect
from rsb_console.command.formatting import clock
from rsb_console.command.target import Asking
from rsb_console.session.client_files import ClientFileProblem, RobotFileText, robot_file

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.commands import Ran
    from tests.support.control import Machine

__all__ = ["path"]

Run: TypeAlias = "Callable[..., Ran]"
ROBOT1, ROBOT2 = Client("robot1", key_file="robot1.key"), Client("robot2", key_file="robot2.key")
SERVER = Session(name="pc", role="server", server_ip="10.0.0.20", server_port=49152, clients=(ROBOT1,))


@pytest.fixture
def run(ran: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    monkeypatch.chdir(tmp_path)
    return partial(ran, "client")


def test_robot_is_added_with_all_that_it_needs(path: Path, run: Run) -> None:
    ran = run("add", str(path), "robot2", "--deny", "/camera/*")
    assert ran.code == 0
    assert path.read_text() == TEXT + "  - {name: robot2, key_file: robot2.key, deny: [/camera/*]}\n"
    assert path.with_name("pc.yaml~").read_text() == TEXT
    key_at = path.with_name("robot2.key")
    assert key_at.stat().st_mode & 0o777 == 0o600
    assert parse(ran.out, Path("robot2.yaml")) == Session(
        name="robot2", role="client", server_ip="10.0.0.20", server_port=49152, key_file="robot2.key"
    )
    assert f"key {key_at}, fingerprint {fingerprint(read_key(key_at))}" in ran.err
    assert says(ran.err, ClientEffect.NOT_RUNNING)
    assert says(ran.err, RobotFileText.SAVE_AS, file="robot2.yaml")
    assert says(ran.err, RobotFileText.COPY_SECRET, files=key_at)
    shown = run("show", str(path), "robot2")
    assert (shown.code, shown.out) == (0, ran.out)
    assert "is saved" not in shown.err


def test_robots_file_is_written_where_it_is_wanted(path: Path, run: Run) -> None:
    assert run("add", str(path), "robot2", "-o", "robot2.yaml", "--address", "pc.local").out == ""
    assert load(Path("robot2.yaml")).server_ip == "pc.local"
    again = run("add", str(path), "robot3", "-o", "robot2.yaml")
    assert (again.code, says(again.err, ClientCommandProblem.OUTPUT_EXISTS, path="robot2.yaml")) == (2, True)
    assert "robot3" not in path.read_text()
    assert not Path("robot3.key").exists()


def test_a_running_server_is_told(path: Path, run: Run, machine: Machine) -> None:
    engine = machine.have(ScriptedEngine(SERVER), file=path)
    ran = run("add", "robot2", "--json")  # the file is that of the bridge that runs
    assert ran.code == 0
    assert ran.json["session"] == str(path)
    assert says(ran.json["running"], ClientEffect.ADDED)
    assert "pid" in run("rekey", str(path), "robot2").err
    assert says(run("remove", str(path), "robot1").err, ClientEffect.REMOVED_LINK_CLOSED, name="robot1")
    assert engine.commands == [("add client", ROBOT2), ("change client", ROBOT2), ("remove client", "robot1")]
    assert load(path).clients == (ROBOT2,)
    assert path.with_name("robot1.key").exists()


def test_client_that_was_unlinked_loses_nothing(path: Path, run: Run, machine: Machine) -> None:
    engine = ScriptedEngine(SERVER)
    engine.now = dataclasses.replace(
        engine.now, links=(LINK, dataclasses.replace(LINK, name="robot2", state=State.WAITING))
    )
    machine.serve(engine, file=path)
    run("add", str(path), "robot2")
    assert says(run("rekey", str(path), "robot1").err, ClientEffect.REKEYED_LINK_CLOSED)
    for command, words in (("rekey", f"{ClientEffect.REKEYED()}\n"), ("remove", ClientEffect.REMOVED(name="robot2"))):
        said = run(command, str(path), "robot2").err
        assert words in said
        assert not says(said, ClientEffect.REKEYED_LINK_CLOSED)
        assert not says(said, ClientEffect.REMOVED_LINK_CLOSED)


def test_server_of_one_client_renews_key_in_place(tmp_path: Path, run: Run) -> None:
    """It has no list: its client has its own name and key."""
    path = tmp_path / "robot1.yaml"
    before = write_key(tmp_path / "robot1.key")
    save(replace(SERVER, name="robot1", key_file="robot1.key", clients=None), path)
    assert run("rekey", str(path), "robot1").code == 0
    assert read_key(tmp_path / "robot1.key") != before
    assert load(path).clients is None
    assert run("add", str(path), "robot2").code == 0
    assert load(path).clients == (Client("robot1"), ROBOT2)


@pytest.mark.parametrize(
    ("address", "host", "port"),
    [
        ("10.0.0.9:50000", "10.0.0.9", 50000),
        ("pc.local:50000", "pc.local", 50000),
        ("[2001:db8::1]:50000", "2001:db8::1", 50000),
        ("2001:db8::1", "2001:db8::1", 49152),
        ("10.0.0.9", "10.0.0.9", 49152),
    ],
)
def test_an_address_may_have_a_port(address: str, host: str, port: int, path: Path, run: Run) -> None:
    """`check` accepts the written file."""
    assert run("add", str(path), "robot2", "-o", "robot2.yaml", "--address", address).code == 0
    session = load(Path("robot2.yaml"))
    assert (session.server_ip, session.server_port) == (host, port)


@pytest.mark.parametrize("address", ["10.0.0.9:", "10.0.0.9:0", "10.0.0.9:70000", "10.0.0.9:x", "0.0.0.0:50000", "a b"])
def test_an_address_that_no_client_reaches_changes_nothing(address: str, path: Path, run: Run) -> None:
    for command in (("add", "robot2"), ("rekey", "robot1"), ("show", "robot1")):
        key = path.with_name("robot1.key").read_bytes()
        assert run(*command, str(path), "--address", address).code == 2
        assert (path.read_text(), path.with_name("robot1.key").read_bytes()) == (TEXT, key)


def test_a_bridge_is_named_as_elsewhere(path: Path, run: Run, machine: Machine, tmp_path: Path) -> None:
    """By its name in place of the file; if the other bridge is a client's, the server needs none."""
    machine.serve(ScriptedEngine(SERVER), file=path)
    machine.serve(ScriptedEngine(), file=tmp_path / "robot1.yaml")
    for words in (("list", "pc"), ("list",), ("list", "--bridge", "pc"), ("show", "pc", "robot1")):
        assert run(*words).code == 0, words
    assert run("list", "nobody").code == 2


def test_a_key_is_replaced_while_both_count(path: Path, run: Run, machine: Machine) -> None:
    old = read_key(path.with_name("robot1.key"))
    engine = machine.have(ScriptedEngine(SERVER), file=path)

    begun = run("rekey", str(path), "robot1", "--keep-old")
    new = read_key(path.with_name("robot1-next.key"))
    both = replace(ROBOT1, next_key_file="robot1-next.key")
    assert begun.code == 0
    assert path.read_text() == TEXT.replace("robot1.key", "robot1.key, next_key_file: robot1-next.key")
    assert read_key(path.with_name("robot1.key")) == old
    assert path.with_name("robot1-next.key").stat().st_mode & 0o777 == 0o600
    assert says(begun.err, ClientEffect.BOTH_KEYS_LINK_STAYS)
    assert f"scp -p {path.with_name('robot1-next.key')} USER@ROBOT:robot1.key" in begun.err
    assert says(begun.err, ClientEffect.STEP_FINISH, name="robot1")
    assert (run("rekey", str(path), "robot1", "--keep-old").code, load(path).clients) == (2, (both,))

    used = dataclasses.replace(LINK, fingerprint=fingerprint(old), next_fingerprint=fingerprint(new))
    engine.now = dataclasses.replace(engine.now, links=(used,))
    refused = run("rekey", str(path), "robot1", "--finish")
    assert (
        refused.code,
        says(refused.err, ClientCommandProblem.OLD_KEY_IN_USE, name="robot1", fingerprint=fingerprint(old)),
    ) == (1, True)
    assert load(path).clients == (both,)
    (row,) = run("list", str(path), "--json").json["clients"]
    assert (row["fingerprint"], row["next_fingerprint"], row["problem"]) == (fingerprint(old), fingerprint(new), "")

    engine.now = dataclasses.replace(engine.now, links=(dataclasses.replace(used, fingerprint=fingerprint(new)),))
    finished = run("rekey", str(path), "robot1", "--finish", "--json")
    assert (finished.code, finished.json["fingerprint"]) == (0, fingerprint(new))
    assert path.read_text() == TEXT
    assert read_key(path.with_name("robot1.key")) == new
    assert not path.with_name("robot1-next.key").exists()
    assert engine.commands == [("change client", both), ("change client", ROBOT1)]
    again = run("rekey", str(path), "robot1", "--finish")
    assert (again.code, says(again.err, ClientFileProblem.NO_NEXT_KEY, name="robot1")) == (2, True)


@pytest.mark.parametrize("runs", [False, True], ids=["no server", "not linked"])
@pytest.mark.parametrize(("answer", "finished"), [("y\n", True), ("n\n", False), ("", False), (None, False)])
def test_finish_asks_unless_client_has_new_key(
    path: Path,
    run: Run,
    machine: Machine,
    monkeypatch: pytest.MonkeyPatch,
    runs: bool,
    answer: str | None,
    finished: bool,
) -> None:
    if runs:
        engine = ScriptedEngine(SERVER)
        engine.now = dataclasses.replace(engine.now, links=(dataclasses.replace(LINK, state=State.DOWN),))
        machine.serve(engine, file=path)
    run("rekey", str(path), "robot1", "--keep-old")
    before = path.read_text()
    surroundings.set_stdin(monkeypatch, answer or "", is_terminal=answer is not None)
    surroundings.print_to_terminal(monkeypatch)
    ran = run("rekey", str(path), "robot1", "--finish")
    assert (ran.code == 0, path.read_text() == TEXT) == (finished, finished)
    if not finished:
        assert path.read_text() == before
        problem = Asking.NOBODY if answer is None else ClientCommandProblem.NOT_FINISHED
        assert says(ran.err, problem)
        assert ran.code == (2 if answer is None else 1)
        assert run("rekey", str(path), "robot1", "--finish", "--json").code == 2


class _Logs(Feature):
    name = "logs"

    def __init__(self, events: list[Event]) -> None:
        self.events = events

    def kept_logs(self, name: str) -> list[list[Event]]:
        return [self.events if name == "pc" else [], []]


@pytest.mark.parametrize(("used", "code"), [(("old", "next"), 0), (("next", "old"), 2), (("next of robot2",), 2)])
def test_finish_finds_used_key_in_servers_log(
    path: Path, run: Run, monkeypatch: pytest.MonkeyPatch, used: tuple[str, ...], code: int
) -> None:
    run("rekey", str(path), "robot1", "--keep-old")
    marks = {
        name: fingerprint(read_key(path.with_name(f"robot1{end}.key")))
        for name, end in (("old", ""), ("next", "-next"))
    }
    events = []
    for number, key in enumerate(used):
        which, _, of = key.partition(" of ")
        link, new = of or "robot1", marks[which]
        # The clock is set back in between.
        events.append(Event(number + 1, 1e9 - number, Level.INFO, EventCode.KEY_USED, "linked", link, new=new))
    replaced.FEATURES_ASKED.set(monkeypatch, lambda _: (_Logs(events),))
    ran = run("rekey", str(path), "robot1", "--finish", "--json")
    assert (ran.code, path.read_text() == TEXT) == (code, code == 0)
    assert says(ran.err, ClientEffect.USED, name="robot1", when=clock(1e9 - 1)) is (code == 0)


def test_finish_that_was_cut_off_is_done_again(path: Path, run: Run) -> None:
    """The new key was put in place, and the session was not saved."""
    run("rekey", str(path), "robot1", "--keep-old")
    new = path.with_name("robot1-next.key")
    path.with_name("robot1.key").write_bytes(new.read_bytes())
    assert run("rekey", str(path), "robot1", "--finish", "--yes").code == 0
    assert path.read_text() == TEXT
    assert not new.exists()


def test_a_key_that_others_share_stays_theirs(path: Path, run: Run) -> None:
    shared = write_key(path.with_name("all.key"))
    save(replace(SERVER, key_file="all.key", shared_keys=True, clients=(Client("robot1"), Client("robot2"))), path)
    assert run("rekey", str(path), "robot2", "--keep-old").code == 0
    own = read_key(path.with_name("all-next.key"))
    assert run("rekey", str(path), "robot2", "--finish", "--yes").code == 0
    assert load(path).clients == (Client("robot1"), Client("robot2", "all-next.key"))
    assert read_key(path.with_name("all.key")) == shared
    assert read_key(path.with_name("all-next.key")) == own


def test_a_new_key_gives_up_the_next_one(path: Path, run: Run) -> None:
    run("rekey", str(path), "robot1", "--keep-old")
    assert run("rekey", str(path), "robot1").code == 0
    assert path.read_text() == TEXT


def test_next_key_of_server_is_replaced_by_hand(tmp_path: Path, run: Run) -> None:
    path = tmp_path / "robot1.yaml"
    for name in ("robot1.key", "new.key"):
        write_key(tmp_path / name)
    save(replace(SERVER, name="robot1", key_file="robot1.key", next_key_file="new.key", clients=None), path)
    text = path.read_text()
    for options in ((), ("--finish",)):
        ran = run("rekey", str(path), "robot1", *options)
        assert (ran.code, says(ran.err, ClientFileProblem.NEXT_KEY_OF_SERVER, name="robot1")) == (2, True)
    assert path.read_text() == text


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_roots_keys_belong_to_servers_user(path: Path, run: Run) -> None:
    for file in (path, path.with_name("robot1.key")):
        os.chown(file, 1234, 5678)
    assert run("add", str(path), "robot2").code == 0
    assert run("rekey", str(path), "robot1").code == 0
    for name in ("pc.yaml", "pc.yaml~", "robot1.key", "robot2.key"):
        status = path.with_name(name).stat()
        assert (name, status.st_uid, status.st_gid) == (name, 1234, 5678)
    assert path.with_name("robot1.key").stat().st_mode & 0o777 == 0o600


def test_client_that_shares_key_gets_its_own(path: Path, run: Run) -> None:
    shared = write_key(path.with_name("all.key"))
    save(replace(SERVER, key_file="all.key", clients=(Client("robot1"), Client("robot2"))), path)
    path.with_name("robot2.key").write_text("somebody else's")
    assert run("rekey", str(path), "robot2").code == 0
    assert load(path).clients == (Client("robot1"), Client("robot2", "robot2-2.key"))
    assert read_key(path.with_name("all.key")) == shared


def test_list_shows_linked_clients_and_missing_keys(path: Path, run: Run, machine: Machine) -> None:
    kept = replace(ROBOT2, topics=(Topic("/map", "transmit"),))
    save(replace(SERVER, clients=(ROBOT1, kept)), path)
    engine = ScriptedEngine(SERVER)
    engine.now = dataclasses.replace(engine.now, links=(LINK,))
    machine.serve(engine, file=path)
    ran = run("list", "--json")
    first, second = ran.json["clients"]
    assert (first["name"], first["state"], first["problem"]) == ("robot1", "ok", "")
    assert first["fingerprint"] == fingerprint(read_key(path.with_name("robot1.key")))
    assert (second["state"], second["topics"]) == ("", ["/map"])
    assert says(second["problem"], KeyFileProblem.NO_SUCH_FILE)
    lines = run("list", str(path)).out.splitlines()
    assert lines[0].split()[:3] == ["robot1", "OK", "robot1.key"]
    assert says(lines[1], KeyFileProblem.NO_SUCH_FILE)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("add", "robot1"), 2, ClientProblem.EXISTS(name="robot1")),
        (("add", "robot2", "--key-file", "gone/robot2.key"), 1, "gone/robot2.key: cannot be written"),
        (("add", ""), 2, f"client 2, name: {SessionMistake.NAME_UNPRINTABLE(name=repr(''))}"),
        (("add", "robot2", "--allow", "scan"), 2, "client robot2, allow[0]: 'scan' matches no topic"),
        (
            ("add", "robot2", "--allow", "{topics: /a, may: write}"),
            2,
            "may: " + ValueMistake.MISFIT(value="'write'", expected=f"one of {', '.join(get_args(May))}", hint=""),
        ),
        (("remove", "robto1"), 2, ClientProblem.MISSPELT(name="robto1", near="robot1")),
        (("rekey", "x"), 2, ClientProblem.UNKNOWN(name="x", names="robot1")),
        (("show", "x"), 2, ClientProblem.UNKNOWN(name="x", names="robot1")),
        (("rekey", "robot1", "--finish"), 2, ClientFileProblem.NO_NEXT_KEY(name="robot1")),
        (("rekey", "robot1", "--keep-old", "-o", "x.yaml"), 2, ClientCommandProblem.OUTPUT_OF_ROTATION()),
    ],
)
def test_refusals_are_in_words_and_change_nothing(
    arguments: tuple[str, ...], code: int, words: str, path: Path, run: Run
) -> None:
    before = sorted(path.parent.rglob("*"))
    name, *options = arguments[1:]
    ran = run(arguments[0], str(path), name, *options)
    assert ran.code == code
    assert words in ran.err
    assert path.read_text() == TEXT
    assert sorted(path.parent.rglob("*")) == before
    assert json.loads(run(arguments[0], str(path), name, *options, "--json").out)["ok"] is False


def test_files_that_cannot_take_a_client(path: Path, run: Run) -> None:
    path.with_name("robot2.key").write_text("mine")
    ran = run("add", str(path), "robot2")
    assert (ran.code, says(ran.err, ClientFileProblem.KEY_EXISTS, path=path.with_name("robot2.key"))) == (2, True)
    path.with_name("robot2.key").unlink()

    path.chmod(0o444)
    ran = run("add", str(path), "robot2")
    assert (ran.code, says(ran.err, SavingProblem.READ_ONLY)) == (1, True)
    assert not path.with_name("robot2.key").exists(), "a key for nobody"

    robot = path.with_name("robot1.yaml")
    robot.write_text(dump(Session(name="robot1", role="client", server_ip="a", server_port=1, key_file="robot1.key")))
    ran = run("add", str(robot), "robot2")
    assert (ran.code, says(ran.err, ClientFileProblem.NOT_A_SERVER, path=robot)) == (2, True)
    ran = run("list")
    assert (ran.code, says(ran.err, ClientCommandProblem.SESSION_UNKNOWN)) == (3, True)


def test_existing_key_is_used_where_it_is_named(path: Path, run: Run) -> None:
    key = write_key(path.with_name("other.key"))
    assert run("add", str(path), "robot2", "--key-file", "other.key").code == 0
    assert load(path).listed_clients[1].key_file == "other.key"
    assert read_key(path.with_name("other.key")) == key


def test_robots_file_guesses_address_of_unspecific_server(path: Path, run: Run) -> None:
    path.write_text(TEXT.replace("10.0.0.20", "0.0.0.0"))
    ran = run("add", str(path), "robot2")
    assert "server_ip" in ran.out
    assert says(ran.out, RobotFileText.ADDRESS_GUESSED)
    assert parse(ran.out, Path("robot2.yaml")).server_ip != "0.0.0.0"


def test_without_encryption_there_is_no_key(path: Path, run: Run) -> None:
    path.write_text(f"{TEXT}use_encryption: false\n".replace(", key_file: robot1.key", ""))
    ran = run("add", str(path), "robot2")
    assert ran.code == 0
    assert not path.with_name("robot2.key").exists()
    assert "key" not in ran.err
    assert parse(ran.out, Path("robot2.yaml")).use_encryption is False
    assert run("rekey", str(path), "robot2").code == 2


def test_a_server_begins_without_clients(tmp_path: Path, run: Run) -> None:
    path = tmp_path / "pc.yaml"
    save(replace(SERVER, clients=()), path)
    assert "clients: []" in path.read_text()
    empty = path.read_text()
    assert run("list", str(path), "--json").json["clients"] == []
    assert run("show", str(path), "robot1").code == 2
    assert run("add", str(path), "robot1").code == 0
    assert load(path).clients == (Client("robot1", "robot1.key"),)
    assert run("remove", str(path), "robot1").code == 0
    assert load(path).clients == ()
    assert path.read_text() == empty


def test_robots_file_takes_topics_and_domain_without_its_comments() -> None:
    session = Session(name="pc", role="server", server_ip="10.0.0.1", server_port=4000, use_encryption=False)
    text = robot_file(session, Client("robot1"))
    assert "[]" not in text
    as_written, begun = (parse(each, Path("robot1.yaml")) for each in (text, without_comments(text)))
    assert (as_written.topics, as_written.domain_id) == ((), None)
    assert (begun.topics, begun.domain_id) == ((Topic("/scan", "transmit"),), 0)


def without_comments(text: str) -> str:
    """Return a file whose commented entries count, without its first line, which is about the file."""
    lines = text.splitlines(keepends=True)[1:]
    return "".join(
        line.removeprefix("# ") if line.startswith(("# domain_id", "# topics")) else line.replace("#   -", "  -", 1)
        for line in lines
    )
