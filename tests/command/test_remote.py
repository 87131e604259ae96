"""The commands that attach to a running bridge: what they print, what they do there, and how they exit."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import msgspec
import pytest
from tests.console.scripted import ROUTES, SESSION, ScriptedEngine, route
from tests.support import constants, replaced, surroundings
from tests.support.forker import Forked
from tests.support.waiting import eventually
from tests.support.wording import says

from rsb_bridge.api import EngineError
from rsb_bridge.config.session_file import dump
from rsb_bridge.control.bridges import SessionRuns, running_bridges
from rsb_bridge.control.protocol import RequestProblem
from rsb_bridge.control.remote_engine import RemoteEngine, attach
from rsb_bridge.model.by_hand import OLD_AFTER, VelocityLimits
from rsb_bridge.model.clock import Clock
from rsb_bridge.model.commands import AskHolder, KeepArmed
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import (
    Acknowledgement,
    ArmingSnapshot,
    Ledger,
    RefusedClient,
    Reloaded,
    RouteSnapshot,
    State,
)
from rsb_bridge.route.arming import Disarmed
from rsb_bridge.route.lease import Standstill
from rsb_console.command.arming_commands import ArmingNote
from rsb_console.command.headless import HeadlessText
from rsb_console.command.route_commands import TopicCommandProblem
from rsb_console.command.target import Asking, BridgeChoice, RouteChoice
from rsb_console.command.watching_commands import WatchingProblem
from rsb_console.session.draft import TypedProblem

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.control import Machine

    from rsb_bridge.model.commands import Command

LINK = ScriptedEngine().now.links[0]
NO_LINK = RouteChoice.UNKNOWN_LINK(bridge="robot1", name="robot7", known="robot1")
NOT_BRIDGED = RouteChoice.NOT_BRIDGED(topic="/scna", hint="; did you mean /scan?")
SCAN = route("/scan", outgoing=True, spec=Topic("/scan", "transmit", max_rate=5.0))


@pytest.fixture
def engine(machine: Machine) -> ScriptedEngine:
    return machine.have(ScriptedEngine(msgspec.structs.replace(SESSION, topics=(SCAN.spec,)), routes=(SCAN,)))


def test_status_tells_state_and_faults(ran: Any, engine: ScriptedEngine) -> None:
    fine = ran("status")
    assert fine.code == 0
    assert fine.out.startswith(f"robot1: client, 10.0.0.20:49152, domain 3, pid {os.getpid()}\n")
    assert "→ /scan 10.0 Hz" in fine.out
    status = ran("status", "robot1", "--json").json
    assert (status["name"], status["pid"], status["running"]) == ("robot1", os.getpid(), True)
    assert status["links"]["robot1"]["state"] == "ok"
    assert status["routes"][0]["topic"] == "/scan"
    assert (status["ok"], status["wrong"], status["waiting"]) == (True, [], [])
    engine.now = replace(engine.now, routes=ROUTES)
    faulty = ran("status")
    assert faulty.code == 1
    assert "← /robot2/scan DOWN: no publisher of /scan in domain 4" in faulty.out


def test_fault_of_link_is_told_once(ran: Any, engine: ScriptedEngine) -> None:
    reason = "its keys differ"
    down = replace(LINK, state=State.DOWN, cause="wrong_key", reason=reason)
    topics = (SCAN, route("/map", outgoing=True))
    routes = tuple(replace(each, state=State.DOWN, cause="link_down", reason=reason) for each in topics)
    engine.now = replace(engine.now, links=(down,), routes=routes)
    status = ran("status")
    assert status.code == 1
    assert status.out.count(reason) == 1
    assert "2 topics wait for it: /scan and /map" in status.out


def test_status_tells_pause_shutdown_and_next_attempt(ran: Any, engine: ScriptedEngine) -> None:
    paused = replace(SCAN, state=State.PAUSED, cause="paused", reason="paused (anna on pts/3)")
    engine.now = replace(engine.now, routes=(paused,))
    assert "anna on pts/3" in ran("status").out
    down = replace(LINK, state=State.DOWN, cause="shut_down", reason="shut down by bert on pts/4", retry_in=26.3)
    engine.now = replace(engine.now, links=(down,))
    assert "bert on pts/4; asks again in 27 s" in ran("status").out


def test_status_names_a_client_that_is_refused(ran: Any, engine: ScriptedEngine) -> None:
    """Anybody can have it refused, so it makes nothing wrong."""
    refused = RefusedClient("robot9", "10.0.0.9", "unknown_name", "unknown: add it", 1_700_000_000.0, 3)
    engine.now = replace(engine.now, refused=(refused,))
    status = ran("status")
    assert status.code == 0
    assert "robot9 at 10.0.0.9" in status.out
    (of_client,) = ran("status", "--json").json["refused"]
    assert (of_client["name"], of_client["cause"], of_client["attempts"]) == ("robot9", "unknown_name", 3)


WAITS = replace(SCAN, state=State.WAITING, cause="no_publisher", reason="no publisher of /scan", last_at=None)


@pytest.mark.parametrize(
    ("what", "code", "short"),
    [
        (SCAN, 0, "nothing is wrong"),
        (WAITS, 0, "nothing is wrong, 1 waits"),
        (replace(WAITS, reason="no publisher of /scna; did you mean /scan?"), 0, "nothing is wrong, 1 waits"),
        (replace(WAITS, state=State.STALE), 0, "nothing is wrong, 1 waits"),
        (replace(WAITS, state=State.STALE, spec=Topic("/scan", "transmit", stale_after=2.0)), 1, "1 thing wrong"),
        (replace(SCAN, state=State.STALE, cause="publisher_silent"), 1, "1 thing wrong"),
        (replace(SCAN, state=State.PAUSED, cause="paused"), 0, "nothing is wrong"),
        (replace(SCAN, state=State.UNHEARD, cause="no_subscriber"), 0, "nothing is wrong, 1 unheard"),
        (replace(SCAN, state=State.UNHEARD, cause="qos_incompatible"), 1, "1 thing wrong, 1 unheard"),
        (replace(SCAN, state=State.SLOW, cause="slow"), 1, "1 thing wrong"),
        (replace(LINK, state=State.WAITING, reason="not connected yet"), 0, "nothing is wrong, 1 waits"),
        (replace(LINK, state=State.DOWN, reason="no answer"), 1, "1 thing wrong"),
        (replace(LINK, warning="two machines are called robot1"), 1, "1 thing wrong"),
    ],
)
def test_waiting_is_no_fault(ran: Any, engine: ScriptedEngine, what: Any, code: int, short: str) -> None:
    if isinstance(what, RouteSnapshot):
        engine.now = replace(engine.now, routes=(what,))
    else:  # the topics of a link that is not up are down, and the link's row shows it
        its = SCAN if what.state is State.OK else replace(SCAN, state=State.DOWN, cause="link_down")
        engine.now = replace(engine.now, links=(what,), routes=(its,))
    status = ran("status")
    assert (status.code, status.out.splitlines()[2].strip()) == (code, short)
    told = ran("status", "--json").json
    assert told["ok"] is (code == 0)
    assert len(told["wrong"]) == code
    assert len(told["waiting"]) == int("waits" in short)
    assert not what.reason or what.reason in str(told["wrong"] + told["waiting"])


KNOWN = Acknowledgement("anna on pts/3", 1_700_000_000.0)
STALE = replace(SCAN, state=State.STALE, cause="publisher_silent")


def test_acknowledged_is_told_apart_and_not_wrong(ran: Any, engine: ScriptedEngine) -> None:
    other = replace(STALE, key="/map", topic="/map")
    engine.now = replace(engine.now, routes=(replace(STALE, acknowledged=KNOWN), other))
    status = ran("status", "--json")
    assert status.code == 1
    assert (len(status.json["wrong"]), len(status.json["acknowledged"])) == (1, 1)
    assert status.json["routes"][0]["acknowledged"] == {"by": KNOWN.by, "at": KNOWN.at}
    assert status.json["routes"][1]["acknowledged"] is None
    lines = ran("status").out.splitlines()
    at = {name: next(n for n, line in enumerate(lines) if name in line) for name in ("/map", "/scan")}
    assert at["/map"] < at["/scan"]
    assert KNOWN.by in lines[at["/scan"]]
    engine.now = replace(engine.now, routes=(replace(STALE, acknowledged=KNOWN),))
    assert ran("status").code == 0
    down = replace(LINK, state=State.DOWN, cause="unreachable", reason="no answer", acknowledged=KNOWN)
    its = replace(SCAN, state=State.DOWN, cause="link_down", acknowledged=KNOWN)
    engine.now = replace(engine.now, links=(down,), routes=(its,))
    status = ran("status", "--json")
    assert (status.code, status.json["wrong"], len(status.json["acknowledged"])) == (0, [], 1)
    assert status.json["links"]["robot1"]["acknowledged"] == {"by": KNOWN.by, "at": KNOWN.at}


def test_ack_takes_a_topic_or_a_link(ran: Any, engine: ScriptedEngine) -> None:
    for arguments in (("/scan",), ("/scan", "--undo"), ("robot1",), ("robot1", "--undo")):
        assert ran("ack", *arguments).code == 0
    assert engine.commands == [
        ("acknowledge", SCAN.key, True),
        ("acknowledge", SCAN.key, False),
        ("acknowledge", "robot1", True),
        ("acknowledge", "robot1", False),
    ]
    assert ran("ack", "/nothing").code == 2


def test_topics_lists_what_is_bridged_or_could_be(ran: Any, engine: ScriptedEngine) -> None:
    assert ran("topics").out == "→ /scan 10.0 Hz (19 dropped)\n"
    assert [each["topic"] for each in ran("topics", "--json").json["topics"]] == ["/scan"]
    sides = [(each["side"], each["topic"]) for each in ran("topics", "--available", "--json").json["available"]]
    assert sides == [("here", "/camera/depth"), ("the server", "/camera/depth")]


def test_commands_do_what_they_say(ran: Any, engine: ScriptedEngine) -> None:
    added = ran("add", "/map", "receive", "protocol=udp", "qos={depth: 3}", "paused=yes", "--json")
    assert added.json == {"ok": True, "key": "/map", "unsaved": False}
    assert "/odom" in ran("add", "/odom", "receive").out
    engine.commands.pop()
    changed = ran("edit", "/scan", "max_rate=", "qos=sensor_data")
    assert changed.code == 0
    for field in ("max_rate", "qos", "/scan", "robot1"):
        assert field in changed.out
    for command, effect in (("remove", "removed"), ("pause", "paused"), ("resume", "resumed"), ("disarm", "disarmed")):
        did = ran(command, "/scan")
        assert (did.code, did.out) == (0, f"{effect}: /scan of robot1 (transmit, /scan there)\n")
    assert "all links" in ran("retry").out
    restarted = ran("restart")
    assert "linked again" in restarted.out
    assert engine.commands == [
        ("add", Topic("/map", "receive", protocol="udp", qos={"depth": 3}, paused=True), ""),
        ("edit", "/scan", Topic("/scan", "transmit", qos="sensor_data")),
        ("remove", "/scan"),
        ("pause", "/scan", True),
        ("pause", "/scan", False),
        ("disarm", "/scan"),
        ("retry", ""),
        ("restart",),
    ]


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("add", "/map", "receive", "prtocol=udp"), "prtocol=udp: unknown key; did you mean protocol? (keys: topic,"),
        (("add", "/map", "receive", "udp"), TypedProblem.NOT_A_PAIR(text="udp")),
        (("add", "/map", "receive", "--rate", "5"), TopicCommandProblem.RATE_WITHOUT_DRY_RUN(topic="/map")),
        (("add", "/map"), TopicCommandProblem.DIRECTION_MISSING(topic="/map")),
        (("add", "/map", "type=String"), TopicCommandProblem.DIRECTION_MISSING(topic="/map")),
        (("edit", "/scan"), TopicCommandProblem.NOTHING_TO_CHANGE(topic="/scan")),
        (("retry", "--link", "robot7"), NO_LINK),
        (("pause", "/scan", "--link", "robot7"), NO_LINK),
        (("add", "/map", "recieve"),
         TopicCommandProblem.DIRECTION_UNKNOWN(topic="/map", word="recieve", hint="; did you mean receive?")),
        (("add", "/map", "receive", "max_rate=fast"), "max_rate: "),
        (("add", "/scan", "transmit"), "topic: "),
        (("pause", "/scna"), NOT_BRIDGED),
        (("wait", "--for", "flowing", "/scna"), NOT_BRIDGED),
        (("wait", "--for", "linked", "robot7"), NO_LINK),
        (("wait", "--for", "happy"), WatchingProblem.CONDITION_UNKNOWN(condition="happy")),
    ],
)  # fmt: skip
def test_what_is_not_valid_is_said_in_words(
    ran: Any, engine: ScriptedEngine, command: tuple[str, ...], words: str
) -> None:
    refused = ran(*command)
    assert refused.code == 2
    assert words in refused.err
    refused = ran(*command, "--json")
    assert refused.json["ok"] is False
    assert words in refused.json["error"]
    assert engine.commands == []


def test_reload_tells_changed_and_unchanged(ran: Any, engine: ScriptedEngine) -> None:
    fine = ran("reload")
    assert (fine.code, fine.out, fine.err) == (0, "/scan (transmit): max_rate none → 5.0\n", "")
    engine.reloads = Reloaded(("/a: x",), ("server_port 1 → 2: restart",), ("/b: y",))
    partly = ran("reload", "--dry-run")
    assert (partly.code, partly.out) == (1, "/a: x\n")
    assert partly.err == "rsb-console: server_port 1 → 2: restart\nrsb-console: /b: y\n"
    assert ran("reload", "--json").json == {
        "ok": False,
        "dry_run": False,
        "changed": ["/a: x"],
        "left": ["server_port 1 → 2: restart"],
        "failed": ["/b: y"],
    }
    ran("reload", "--drop-arm")
    assert engine.commands == [("reload", False), ("reload", True), ("reload", False), ("reload", False, "drop_arm")]


@pytest.mark.parametrize("lines", ["nav2.yaml:7", ""])
def test_remove_says_whether_the_demand_to_arm_stays(lines: str, ran: Any, engine: ScriptedEngine) -> None:
    engine.demanded = lines
    assert (TopicCommandProblem.STILL_DEMANDED(lines=lines) in ran("remove", "/scan").out) == bool(lines)
    assert ran("remove", "/scan", "--json").json["demanded"] == bool(lines)


@pytest.fixture
def armed(engine: ScriptedEngine) -> ScriptedEngine:
    """An engine whose session lists /scan with `arm`."""
    spec = msgspec.structs.replace(SCAN.spec, arm=True)
    engine.session = msgspec.structs.replace(engine.session, topics=(spec,))
    engine.now = replace(engine.now, routes=(replace(SCAN, spec=spec),))
    return engine


def test_removal_of_armed_entry_needs_its_option(ran: Any, armed: ScriptedEngine) -> None:
    for more in (), ("--json",):
        refused = ran("remove", "/scan", *more)
        assert refused.code == 2
        assert says(refused.err or refused.json["error"], Asking.NOBODY, options="--drop-arm or --keep-arm")
    assert armed.commands == []
    assert ran("remove", "/scan", "--keep-arm").code == 0
    assert ran("remove", "/scan", "--drop-arm").code == 0
    assert armed.commands == [("remove", "/scan"), ("remove", "/scan", "drop_arm")]


@pytest.mark.parametrize(("answer", "drops"), [("y\n", True), ("n\n", False), ("\n", False), ("", False)])
def test_removal_of_armed_entry_asks_once(
    ran: Any, armed: ScriptedEngine, monkeypatch: pytest.MonkeyPatch, answer: str, drops: bool
) -> None:
    surroundings.set_stdin(monkeypatch, answer, is_terminal=True)
    assert says(ran("remove", "/scan").err, Asking.NOBODY), "its question would go to a file"
    surroundings.print_to_terminal(monkeypatch)
    removed = ran("remove", "/scan")
    assert removed.code == 0
    assert removed.out.count(TopicCommandProblem.DROP(topic="/scan")) == 1
    assert armed.commands == [("remove", "/scan", *["drop_arm"] * drops)]


def test_removal_asks_only_about_demand_of_entry(ran: Any, engine: ScriptedEngine) -> None:
    """Another line of this side demands arming, or the other side's entry, which only that side can drop."""
    engine.now = replace(engine.now, routes=(replace(SCAN, spec=msgspec.structs.replace(SCAN.spec, arm=True)),))
    assert ran("remove", "/scan").code == 0
    assert engine.commands == [("remove", "/scan")]


def test_removal_asks_nothing_if_another_line_demands_arming_too(ran: Any, armed: ScriptedEngine) -> None:
    """The bridge would refuse to end the demand."""
    arming = ArmingSnapshot(armed=False, demanded_by=("robot.yaml:14", "robot.yaml:20"))
    armed.now = replace(armed.now, routes=(replace(armed.now.routes[0], arming=arming),))
    assert ran("remove", "/scan").code == 0
    assert armed.commands == [("remove", "/scan")]


def test_changes_say_that_they_are_not_saved(ran: Any, engine: ScriptedEngine, tmp_path: Path) -> None:
    saved, path = ran("pause", "/scan"), tmp_path / "nav2.yaml"
    assert "not saved" not in saved.out
    path.write_text(dump(engine.session))
    engine.use_file(path)
    assert ran("status", "--json").json["unsaved"] is False
    engine.session = msgspec.structs.replace(engine.session, topics=())
    for command in (
        ("add", "/new", "transmit"), ("edit", "/scan", "max_rate=5"), ("pause", "/scan"), ("remove", "/scan"),
    ):  # fmt: skip
        assert "not saved" in ran(*command).out
        assert ran(*command, "--json").json["unsaved"] is True
    assert "not saved" in ran("status").out
    assert ran("status", "--json").json["unsaved"] is True
    assert ran("save").code == 0
    assert engine.commands[-1] == ("save",)
    assert "not saved" not in ran("status").out


def test_topic_of_both_directions_needs_its_direction(ran: Any, engine: ScriptedEngine) -> None:
    back = route("/scan", key="back")
    engine.now = replace(engine.now, routes=(SCAN, back))
    options = "--link robot1 --direction transmit; --link robot1 --direction receive"
    for command in (("remove", "/scan"), ("edit", "/scan", "max_rate=5"), ("arm", "/scan")):
        assert says(ran(*command).err, RouteChoice.SEVERAL, topic="/scan", count=2, options=options)
    assert engine.commands == []
    assert ran("pause", "/scan", "--direction", "receive").code == 0
    assert engine.commands == [("pause", "back", True)]


def attach_takes(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Have commands wait so long for their bridge."""
    steady = Clock.steady

    def slowly(*arguments: Any, **more: Any) -> RemoteEngine:
        engine = attach(*arguments, **more)
        replaced.STEADY_CLOCK.set(monkeypatch, staticmethod(lambda: steady() + seconds))
        return engine

    replaced.TARGET_ATTACH.set(monkeypatch, slowly)


@pytest.mark.parametrize("command", [("resume", "/scan"), ("edit", "/scan", "paused=")], ids=lambda words: words[0])
def test_a_command_that_began_long_ago_resumes_nothing(
    ran: Any, engine: ScriptedEngine, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    paused = msgspec.structs.replace(SCAN.spec, paused=True)
    engine.session = msgspec.structs.replace(engine.session, topics=(paused,))
    engine.now = replace(engine.now, routes=(replace(SCAN, spec=paused),))
    attach_takes(monkeypatch, OLD_AFTER + 0.1)
    assert says(ran(*command).err, RequestProblem.TOO_LATE)
    assert engine.commands == []


@pytest.mark.parametrize(
    ("command", "given"), [("disarm", ("disarm",)), ("pause", ("pause", True)), ("resume", ("pause", False))]
)
def test_what_stops_a_name_stops_all_its_routes(
    command: str, given: tuple[Any, ...], ran: Any, engine: ScriptedEngine
) -> None:
    """Another direction, another name on the other side, another link: an option may select one of them."""
    others = (
        replace(SCAN, key="there", remote_topic="/elsewhere"),
        route("/scan", key="back"),
        replace(route("/scan", key="far"), link="robot2"),
    )
    engine.now = replace(engine.now, links=(*engine.now.links, replace(LINK, name="robot2")), routes=(SCAN, *others))
    name, *more = given

    def keys(*options: str) -> set[str]:
        engine.commands.clear()
        assert ran(command, "/scan", *options).code == 0
        assert {(each[0], *each[2:]) for each in engine.commands} == {(name, *more)}
        return {str(each[1]) for each in engine.commands}

    assert keys() == {SCAN.key, "there", "back", "far"}
    assert keys("--link", "robot2") == {"far"}
    assert keys("--remote", "/elsewhere") == {"there"}
    assert len(ran(command, "/scan", "--json").json["routes"]) == 4


def test_options_that_tell_routes_apart_work(ran: Any, engine: ScriptedEngine) -> None:
    routes = (SCAN, replace(SCAN, key="there", remote_topic="/elsewhere"), route("/scan", key="back"))
    engine.now = replace(engine.now, routes=routes)
    start, end = RouteChoice.SEVERAL(topic="/scan", count=3, options="|").split("|")
    said = ran("remove", "/scan").err.partition(start)[2].strip().removesuffix(end).split("; ")
    assert len(set(said)) == len(routes)
    for options in said:
        assert ran("remove", "/scan", *options.split()).code == 0
    assert [command[1] for command in engine.commands] == [each.key for each in routes]


def test_a_topic_of_a_server_has_two_names(ran: Any, engine: ScriptedEngine) -> None:
    """The one on the server's screen, and the client's; in every command."""
    engine.now = replace(engine.now, routes=(route("/robot1/scan", key="k", spec=SCAN.spec),))
    for name in ("/robot1/scan", "/scan"):
        assert ran("pause", name).code == 0
        assert ran("edit", name, "max_rate=2").code == 0
        assert ran("remove", name).code == 0
        assert ran("wait", "--for", "flowing", name, "--timeout", "0").code == 0
    changed = ("edit", "k", Topic("/scan", "transmit", max_rate=2.0))
    assert engine.commands == [("pause", "k", True), changed, ("remove", "k")] * 2


def test_wait_waits(ran: Any, engine: ScriptedEngine) -> None:
    assert ran("wait", "--for", "flowing", "/scan", "--timeout", "10").code == 0
    assert ran("wait", "--for", "linked", "robot1", "--json").json["ok"]
    engine.now = replace(
        engine.now, routes=(replace(SCAN, state=State.WAITING, reason="no publisher", ledger=Ledger()),)
    )
    late = ran("wait", "--for", "flowing", "/scan", "--timeout", "0.1")
    assert late.code == 1
    assert "/scan WAITING: no publisher" in late.err


def test_server_waits_for_topic_that_client_may_bring(ran: Any, machine: Machine) -> None:
    machine.serve(ScriptedEngine(msgspec.structs.replace(SESSION, role="server"), routes=(SCAN,)))
    late = ran("wait", "--for", "flowing", "/scna", "--timeout", "0")
    assert late.code == 1
    assert says(late.err, WatchingProblem.NOT_REACHED, condition="flowing /scna", seconds=0)
    assert says(late.err, WatchingProblem.NOT_BROUGHT, topic="/scna", hint="; did you mean /scan?")


def test_server_of_several_needs_clients_name(ran: Any, machine: Machine) -> None:
    engine = ScriptedEngine(msgspec.structs.replace(SESSION, role="server"))
    engine.now = replace(engine.now, links=(LINK, replace(LINK, name="robot2")))
    machine.serve(engine)
    refused = ran("add", "/map", "receive")
    question = TopicCommandProblem.CLIENT_MISSING(topic="/map", links="robot1 or --link robot2")
    assert (refused.code, refused.err) == (2, f"rsb-console: {question}\n")
    assert ran("add", "/map", "receive", "--link", "robot2").code == 0


NEEDED = {
    **dict.fromkeys(("edit", "remove", "pause", "resume", "ack", "arm", "disarm", "echo", "hz", "bw", "info"), "/scan"),
    "wait": "--for stopped",
    "add": "/scan transmit",
    "look": "/scan --once",
    "call": "/dock",
    "param get": "/n a",
    "param describe": "/n",
    "param list": "/n",
    "param set": "/n a 1",
    "param dump": "/n",
    "param diff": "/n a.yaml",
    "param load": "/n a.yaml",
    "component list": "",
    "component load": "/n a a::B",
    "component unload": "/n /a",
}
"""The arguments that commands need."""
ALONE = ("status", "topics", "retry", "restart", "reload", "save", "events", "stop")
"""Commands that need none."""


@pytest.mark.parametrize("name", sorted({*ALONE, *NEEDED}))
def test_every_command_takes_bridge_in_same_way(ran: Any, machine: Machine, name: str) -> None:
    words = *name.split(), *NEEDED.get(name, "").split()
    assert ran(*words, "--bridge", "robot7", "--json").code == 3
    machine.serve()
    assert says(ran(*words, "--bridge", "robot7").err, BridgeChoice.UNKNOWN, name="robot7")
    if name not in NEEDED:
        assert ran(name, "robot7").code == 3


def test_without_a_bridge_they_say_so(ran: Any, machine: Machine) -> None:
    nothing = ran("status")
    assert (nothing.code, nothing.err) == (3, f"rsb-console: {BridgeChoice.NONE_RUNS()}\n")
    machine.serve()
    other = ran("status", "robot2")
    assert other.code == 3
    assert says(other.err, BridgeChoice.UNKNOWN, name="robot2")
    assert "\n  robot1: client, 10.0.0.20:49152, pid" in other.err
    assert ran("status", "--control", str(machine.folder / "x.sock")).code == 3


def test_status_of_all_exits_with_worst_code(ran: Any, machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    first = ScriptedEngine(routes=(SCAN,))
    second = ScriptedEngine(msgspec.structs.replace(SESSION, name="robot2"), routes=(SCAN,))
    second.now = replace(second.now, name="robot2")
    for engine in (first, second):
        machine.serve(engine)
    fine = ran("status")
    assert fine.code == 0
    assert [line.partition(":")[0] for line in fine.out.splitlines() if not line.startswith(" ")] == [
        "robot1",
        "robot2",
    ]
    second.now = replace(second.now, links=(replace(LINK, state=State.DOWN, cause="lost"),))
    faulty = ran("status", "--json")
    assert faulty.code == 1
    assert faulty.json["ok"] is False
    assert [(each["name"], each["ok"]) for each in faulty.json["bridges"]] == [("robot1", True), ("robot2", False)]
    assert ran("status", "robot1").code == 0
    frozen = [replace(each, info=None, problem="frozen") for each in running_bridges()[:1]]
    replaced.STATUS_BRIDGES.set(monkeypatch, lambda: [*frozen, *running_bridges()[1:]])
    assert ran("status").code == 3


def test_of_several_bridges_one_has_to_be_named(ran: Any, machine: Machine) -> None:
    machine.serve()
    machine.serve(ScriptedEngine(msgspec.structs.replace(SESSION, name="robot2")))
    several = ran("topics")
    assert several.code == 2
    assert "robot1: " in several.err
    assert ran("topics", "robot2").code == 0
    assert ran("topics", "--control", str(machine.folder / "robot2.sock")).code == 0


def test_sockets_of_bridges_with_one_name_are_listed(
    ran: Any, machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    services = tmp_path / "services"
    services.mkdir(mode=0o700)
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(services))
    machine.serve()
    machine.serve(environ={"RUNTIME_DIRECTORY": str(services)})
    both = ran("status", "--bridge", "robot1")
    assert both.code == 2
    for folder in (machine.folder, services):
        assert f"--control {folder / 'robot1.sock'}" in both.err
        assert ran("topics", "--control", str(folder / "robot1.sock")).code == 0


@pytest.fixture
def bridge(here: None, path: Path) -> Iterator[Forked]:
    with start("run", "--no-ui", str(path)) as process:
        assert "connecting" in process.stdout.readline()
        yield process
        process.kill()


def start(*arguments: str) -> Forked:
    return Forked("rsb_console", *arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def test_headless_bridge_is_attached_to_changed_and_stopped(ran: Any, bridge: Forked, path: Path) -> None:
    status = ran("status", "--json").json
    assert (status["pid"], status["file"]) == (bridge.pid, str(path))
    with start("events", "--json", "--follow") as following:
        assert json.loads(following.stdout.readline())["code"] == "link.connecting"
        assert ran("add", "/map", "receive", "type=OccupancyGrid").code == 0
        assert ran("pause", "/scan").code == 0
        assert ran("remove", "/map").code == 0
        waited = ran("wait", "--for", "linked", "--timeout", "0.1")
        assert waited.code == 1
        topics = ran("topics", "--json").json["topics"]
        assert [each["topic"] for each in topics] == ["/scan"]
        assert ran("stop").code == 0
        assert bridge.wait(60) == 0
        codes = (json.loads(line)["code"] for line in following.stdout)
        assert next(code for code in codes if code == "attach.lost")
        following.terminate()
    assert ran("status").code == 3


def test_a_bridge_is_named_as_it_was_chosen(ran: Any, engine: ScriptedEngine, machine: Machine) -> None:
    """Two of one name run here, with different servers."""
    other = ScriptedEngine()
    other.now = replace(other.now, address="elsewhere:7400")
    machine.serve(other, on_stop=lambda: threading.Thread(target=machine.served[-1].close).start())
    assert {each["name"] for each in ran("status", "--json").json["bridges"]} == {"robot1", "robot1-2"}
    stopped = ran("stop", "robot1-2")
    assert (stopped.code, stopped.out.split()) == (0, ["stopped:", "robot1-2"])


def test_a_session_is_not_started_twice(ran: Any, bridge: Forked, path: Path) -> None:
    with start("run", "--no-ui", str(path)) as second:
        _, errors = second.communicate(60)
    assert second.returncode == 4
    assert says(errors, SessionRuns.ANSWERING, name="robot1", pid=bridge.pid)
    assert says(errors, HeadlessText.RUNS_ALREADY, command="rsb-console attach robot1")
    assert "Traceback" not in errors
    bridge.send_signal(signal.SIGKILL)
    bridge.wait()
    with start("run", "--no-ui", str(path)) as third:
        eventually(lambda: ran("status").code != 3, what="the dead one's socket is replaced")
        third.terminate()
        assert third.wait(60) == 0


def test_details_tell_holder_and_limits(ran: Any, engine: ScriptedEngine) -> None:
    armed = ArmingSnapshot(armed=True, by="anna on pts/3", left=12.0, deadman=20.0)
    shown = replace(SCAN, arming=armed, max_age=0.5, limits=VelocityLimits(0.5), limited_by=("robot.yaml:14",))
    engine.now = replace(engine.now, routes=(replace(shown, ledger=Ledger()),))
    lines = ran("info", "/scan").out.splitlines()
    assert any("anna on pts/3" in line for line in lines)
    assert any("0.5 s" in line for line in lines)
    assert any("robot.yaml:14" in line and "0.5 m/s" in line for line in lines)
    found = ran("info", "/scan", "--json").json
    limits = {"linear": 0.5, "angular": None, "limited_by": ["robot.yaml:14"]}
    assert (found["max_age"], found["limits"]) == (0.5, limits)


@pytest.mark.parametrize(("option", "command"), [("--ask", "ask_holder"), ("--take", "take_arming"), ("", "arm")])
def test_what_another_holds_is_asked_for_or_taken(option: str, command: str, ran: Any, engine: ScriptedEngine) -> None:
    engine.now = replace(engine.now, routes=(SCAN,))
    ran("arm", "/scan", *filter(None, (option,)))
    assert engine.commands[0][:2] == (command, "/scan")


def test_who_asks_in_shell_gives_signs_of_life(
    ran: Any, engine: ScriptedEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without them, the question ends."""
    constants.ASKER_ALIVE_EVERY.set(monkeypatch, 0.01)
    asked: Future[None] = Future()
    alive: list[bool] = []

    def answer(command: Command[Any]) -> Future[Any] | None:
        match command:
            case AskHolder():
                return asked
            case KeepArmed(pressed):
                alive.append(pressed)
                if len(alive) == 3:
                    asked.set_exception(EngineError("kept"))
        return None

    engine.answering = answer
    engine.now = replace(engine.now, routes=(SCAN,))
    result = ran("arm", "/scan", "--ask")
    assert "kept" in result.err
    assert alive[:3] == [False] * 3


class Terminal:
    engine: ScriptedEngine

    def __init__(self, *_: object) -> None:
        pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def _becomes(self, arming: ArmingSnapshot) -> None:
        self.engine.now = replace(self.engine.now, routes=(replace(SCAN, arming=arming),))


class Keys(Terminal):
    """A terminal of `arm` whose operator presses Enter all the time until somebody asks.

    Attributes:
        keeps: whether the operator answers.
    """

    questions: list[str]
    keeps: bool
    patch: pytest.MonkeyPatch

    def __init__(self, *_: object) -> None:
        self._answers = 0

    def wait(self, seconds: float) -> bool:
        constants.OLD_AFTER.set(self.patch, 50.0)
        time.sleep(seconds)  # in which the bridge's states come
        if not self.questions:
            self._becomes(ArmingSnapshot(armed=True, asked_by="bert", goes_in=9.0))
            return True
        self._answers += 1
        if self._answers > 1:
            self._becomes(ArmingSnapshot(armed=False))
        return self.keeps and self._answers == 1


@pytest.mark.parametrize("keeps", [True, False])
def test_shell_asks_holder_and_enter_keeps_topic(
    keeps: bool, ran: Any, engine: ScriptedEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An Enter from before the question is no answer. The command itself is old by then, its answer is not."""
    Keys.engine, Keys.questions, Keys.keeps = engine, [], keeps
    engine.now = replace(engine.now, routes=(replace(SCAN, arming=ArmingSnapshot(armed=True)),))
    engine.holds = ("/scan",)
    Keys.patch = monkeypatch
    attach_takes(monkeypatch, 100.0)
    constants.OLD_AFTER.set(monkeypatch, 200.0)
    replaced.REMOTE_TYPED_KEYS.set(monkeypatch, Keys)
    replaced.REMOTE_PRINT_ERROR.set(monkeypatch, Keys.questions.append)
    ran("arm", "/scan")
    (question,) = Keys.questions
    assert says(question, ArmingNote.ASKED_FOR)
    assert "bert" in question
    answers = [each for each in engine.commands if each[0] == "answer_asker"]
    assert answers == ([("answer_asker", "/scan", False)] if keeps else [])


class Holding(Terminal):
    """A terminal of `arm`, while another operator takes the topic and holds it."""

    def wait(self, seconds: float) -> bool:
        time.sleep(seconds)
        self._becomes(ArmingSnapshot(armed=True, by="bert\x1b[2J", here=True, asked_by="carl", goes_in=9.0))
        self.engine.holds = ()
        return False


def test_arm_ends_once_another_operator_holds_the_topic(
    ran: Any, engine: ScriptedEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Questions to the new holder are not for this command's operator."""
    Holding.engine = engine
    engine.holds = ("/scan",)
    engine.now = replace(engine.now, routes=(replace(SCAN, arming=ArmingSnapshot(armed=True, here=True)),))
    replaced.REMOTE_TYPED_KEYS.set(monkeypatch, Holding)
    result = ran("arm", "/scan")
    assert result.code == 1
    assert says(result.err, ArmingNote.HELD_BY_ANOTHER, topic="/scan", who="bert\\x1b[2J")
    assert not says(result.err, ArmingNote.ASKED_FOR)


class StandsStill(Terminal):
    """A terminal of `arm` whose bridge hangs, and then shows the earlier state for a moment."""

    def __init__(self, *_: object) -> None:
        self._waits = 0

    def wait(self, seconds: float) -> bool:
        self._waits += 1
        match self._waits:
            case 2:
                time.sleep(_STANDS_STILL)
                self.engine.holds = ()
            case 3:
                self._becomes(ArmingSnapshot(armed=False, why=Disarmed.LEASE, reason=Standstill.LOOP.value))
        return False


_STANDS_STILL = 1.2
"""s, which are longer than a state takes to be shown."""


def test_arm_after_standstill_names_no_takeover_by_itself(
    ran: Any, engine: ScriptedEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    StandsStill.engine = engine
    engine.holds = ("/scan",)
    engine.now = replace(engine.now, routes=(replace(SCAN, arming=ArmingSnapshot(armed=True, by="anna", here=True)),))
    replaced.REMOTE_TYPED_KEYS.set(monkeypatch, StandsStill)
    result = ran("arm", "/scan", "--json")
    assert result.code == 1
    said = json.loads(result.out.splitlines()[-1])
    assert (said["ok"], said["cause"]) == (False, Disarmed.LEASE)
    assert Standstill.LOOP.value in said["error"]
    assert not says(result.out + result.err, ArmingNote.HELD_BY_ANOTHER)
