"""The commands about services, actions and parameters: adding and naming them, calling them, and what is printed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.console.scripted import SESSION, ScriptedEngine, answered, route, whole_answer
from tests.support import surroundings
from tests.support.wording import says

from rsb_bridge.api import EngineError, InvalidRequestError
from rsb_bridge.config.decoding import ValueMistake
from rsb_bridge.config.topic_rules import A_KIND
from rsb_bridge.config.validation import SessionMistake
from rsb_bridge.model.calls import CallsSnapshot, GoalSnapshot
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import ArmingSnapshot, Ledger, Stage, State
from rsb_bridge.model.topic_keys import ForeignKey
from rsb_console.command.call_command import CallProblem
from rsb_console.command.route_commands import TopicCommandProblem
from rsb_console.command.target import RouteChoice
from rsb_console.notation.formats import AnswerText

if TYPE_CHECKING:
    from tests.support.control import Machine

    from rsb_bridge.model.session import Kind
    from rsb_bridge.model.snapshot import RouteSnapshot


def called(topic: str, kind: Kind = "service", **changes: Any) -> RouteSnapshot:
    lanes = {"action": ("send_goal", "cancel_goal"), "parameters": ("get_parameters", "set_parameters")}
    return replace(
        route(topic, key=f"{kind} {topic}", spec=Topic(topic, "receive", kind=kind)),
        **{"calls": CallsSnapshot(), "ledger": Ledger(), "rate": 0.0, "lanes": lanes.get(kind, ("",)), **changes},
    )


DOCK = called("/dock", calls=CallsSnapshot(9, 4, 1, {"calls a second": 2}, 1, 1), rate=2.5)
NAVIGATE = called("/navigate", "action", goals=(GoalSnapshot("ab" * 16, "executing", 1.0, 5, result_awaited=True),))
NODE = called("/controller", "parameters")
SCAN = route("/dock", key="scan", outgoing=True, spec=Topic("/dock", "transmit"))


@pytest.fixture
def engine(machine: Machine) -> ScriptedEngine:
    routes = (DOCK, NAVIGATE, NODE)
    made = ScriptedEngine(msgspec.structs.replace(SESSION, topics=tuple(r.spec for r in routes)), routes=routes)
    machine.serve(made)
    return made


def answer(engine: ScriptedEngine, text: str) -> None:
    engine.called.set_result(text)


@pytest.mark.parametrize(
    ("words", "topic"),
    [
        (("--service", "/map", "--provider", "server"), Topic("/map", "transmit", kind="service")),
        (("/map", "--kind", "service", "provider=client"), Topic("/map", "receive", kind="service")),
        (("--action", "/go", "--provider", "client", "timeout=5", "remote_action=/far", "arm=yes"),
         Topic("/go", "receive", kind="action", timeout=5.0, remote_topic="/far", arm=True)),
        (("/map", "--service", "type=nav_msgs/srv/GetMap", "--provider", "client", "max_rate=2"),
         Topic("/map", "receive", kind="service", type="nav_msgs/srv/GetMap", max_rate=2.0)),
        (("--parameters", "/n", "provider=client"), Topic("/n", "receive", kind="parameters")),
    ],
)  # fmt: skip
def test_what_is_called_is_added_with_its_provider(
    ran: Any, engine: ScriptedEngine, words: tuple[str, ...], topic: Topic
) -> None:
    assert ran("add", *words).code == 0
    assert engine.commands == [("add", topic, "")]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--service", "/map"), TopicCommandProblem.PROVIDER_MISSING(topic="/map", kind="service")),
        (("--service", "/map", "transmit"),
         TopicCommandProblem.KEY_WITHOUT_VALUE(topic="/map", word="transmit", kind="service")),
        (("/map", "transmit", "--provider", "client"), TopicCommandProblem.PROVIDER_OF_A_TOPIC(topic="/map")),
        (("--service", "/map", "provider=robot"),
         f"provider: {ValueMistake.MISFIT(value=repr('robot'), expected='one of client, server', hint='')}"),
        (("--service", "/map", "provider=client", "qos=5"), f"qos=5: {ForeignKey.QOS_OF_CALLED()} (keys"),
        (("--service", "/map", "provider=client", "timout=5"), "timout=5: unknown key; did you mean timeout?"),
        (("--service", "/map", "provider=client", "timeout=0"), "timeout: 0.0 is out of"),
        (("--service", "map", "provider=client"), "service: 'map' is not an"),
        (("--service", "/map", "provider=client", "remote_service=x"), "remote_service: 'x' is not an"),
        (("--service", "/map", "provider=client", "type=Trigger"), "type: 'Trigger' is no type"),
        (("--service", "/dock", "provider=client"),
         f"service: {SessionMistake.TOPIC_TWICE(name='/dock', end='provider: client', number=1)}"),
        (("/map", "transmit", "timeout=5"), f"timeout=5: {ForeignKey.TIMEOUT_OF_TOPIC()}"),
    ],
)  # fmt: skip
def test_what_is_not_valid_is_said_in_words(ran: Any, engine: ScriptedEngine, words: tuple[str, ...], why: str) -> None:
    refused = ran("add", *words)
    assert (refused.code, why in refused.err) == (2, True), refused.err
    assert engine.commands == []


def test_every_kind_is_operated_by_its_name(ran: Any, engine: ScriptedEngine) -> None:
    for each in (DOCK, NAVIGATE, NODE):
        assert ran("edit", each.topic, "timeout=5", "paused=yes").code == 0
        for command in ("remove", "pause", "disarm"):
            assert ran(command, each.topic).code == 0
    changes = [msgspec.structs.replace(each.spec, timeout=5.0, paused=True) for each in (DOCK, NAVIGATE, NODE)]
    assert [each[:3] for each in engine.commands if each[0] == "edit"] == [
        ("edit", each.key, changed) for each, changed in zip((DOCK, NAVIGATE, NODE), changes, strict=True)
    ]
    assert [each[1] for each in engine.commands if each[0] == "remove"] == [DOCK.key, NAVIGATE.key, NODE.key]


def test_topic_and_service_of_one_name_differ(ran: Any, engine: ScriptedEngine) -> None:
    engine.now = replace(engine.now, routes=(DOCK, SCAN))
    asked = ran("remove", "/dock")
    assert asked.code == 2
    assert "--kind service; --kind topic" in asked.err
    assert ran("pause", "/dock", "--kind", "service").code == 0
    assert ran("remove", "/dock", "--kind", "topic").code == 0
    assert engine.commands == [("pause", DOCK.key, True), ("remove", "scan")]
    other = replace(DOCK, link="robot2", key="other")
    engine.now = replace(engine.now, routes=(DOCK, SCAN, other))
    both = "--link robot1 --direction receive --kind service; --kind topic; --link robot2 --direction receive --kind"
    assert both in ran("remove", "/dock").err
    engine.commands.clear()
    assert ran("pause", "/dock").code == 0
    assert {each[:2] for each in engine.commands} == {("pause", each.key) for each in (DOCK, SCAN, other)}


def test_command_for_other_kind_names_right_one(ran: Any, engine: ScriptedEngine) -> None:
    echoed = ran("echo", "/dock", "--once")
    assert echoed.code == 2
    assert says(
        echoed.err, RouteChoice.OF_ANOTHER_KIND, topic="/dock", actual=A_KIND["service"], wanted=A_KIND["topic"]
    )
    engine.now = replace(engine.now, routes=(SCAN, NODE))
    assert says(ran("call", "/dock").err, RouteChoice.OF_ANOTHER_KIND, topic="/dock", actual=A_KIND["topic"])
    misspelt = ran("call", "/contrller").err
    assert says(misspelt, RouteChoice.NOT_BRIDGED, topic="/contrller", hint="; did you mean /controller?")


def test_status_and_topics_tell_of_calls(ran: Any, engine: ScriptedEngine) -> None:
    refused = replace(NODE, state=State.DOWN, reason="no server of /controller/get_parameters")
    armed = replace(NAVIGATE, arming=ArmingSnapshot(armed=True, by="anna"))
    engine.now = replace(engine.now, routes=(DOCK, armed, refused))
    lines = [line.strip() for line in ran("status").out.splitlines()]
    assert "← service /dock 2.5 calls/s, 1 under way (1 expired, 2 refused, 1 lost)" in lines
    assert "← action /navigate ARMED (anna): 0.0 calls/s" in lines
    assert "← parameters /controller DOWN: no server of /controller/get_parameters" in lines
    assert ran("topics").out.splitlines()[0] in lines
    crowded = replace(DOCK, calls=CallsSnapshot(asked=12, in_flight=12, waiting=4))
    engine.now = replace(engine.now, routes=(crowded,))
    assert "12 under way, 4 of them wait for the node" in ran("status").out
    assert "4 of those under way wait until the node has taken earlier ones" in ran("info", "/dock").out
    engine.now = replace(engine.now, routes=(DOCK, armed, refused))
    down = replace(engine.now.links[0], state=State.DOWN, reason="no answer")
    engine.now = replace(engine.now, links=(down,))
    assert (
        "1 service, 1 action, parameters of 1 node wait for it: /dock, /navigate and /controller" in ran("status").out
    )


def test_programs_get_the_calls_and_the_goals(ran: Any, engine: ScriptedEngine) -> None:
    engine.now = replace(engine.now, routes=(DOCK, NAVIGATE, SCAN))
    dock, navigate, scan = ran("status", "--json").json["routes"]
    assert (dock["kind"], dock["provider"], navigate["kind"], scan["kind"]) == (
        "service", "client", "action", "topic"
    )  # fmt: skip
    assert (dock["calls"]["asked"], dock["calls"]["refused"]) == (9, {"calls a second": 2})
    assert [goal["state"] for goal in navigate["goals"]] == ["executing"]
    assert not {"calls", "goals", "provider"} & scan.keys()
    assert (dock["goals"], "delivered" in dock) == ([], False)


@pytest.mark.parametrize(("offered", "code"), [(True, 0), (None, 1)])
def test_a_service_flows_once_it_can_be_called(
    ran: Any, engine: ScriptedEngine, offered: bool | None, code: int
) -> None:
    stages = (Stage("server seen", True), Stage("offered", offered), Stage("called", None))
    waits = replace(DOCK, state=State.WAITING, reason="not called yet", stages=stages)
    engine.now = replace(engine.now, routes=(waits,))
    assert ran("wait", "--for", "flowing", "/dock", "--timeout", "0").code == code


def test_a_call_prints_the_response(ran: Any, engine: ScriptedEngine, monkeypatch: pytest.MonkeyPatch) -> None:
    answer(engine, "success: true\nmessage: 'docked'\n# the first 3 of 9 elements\n")
    assert ran("call", "/dock").out == "success: true\nmessage: 'docked'\n# the first 3 of 9 elements\n"
    engine.called_whole = answered(whole_answer())
    printed = ran("call", "/dock", "{speed: 1}", "--json").json
    (landed,) = printed.pop("landed")
    assert printed == {"ok": True, "response": {"success": True, "message": "docked"}}
    assert landed["ok"]
    assert says(landed["report"], AnswerText.ANSWERED, link=DOCK.link)
    surroundings.set_stdin(monkeypatch, "speed: 2\n")
    assert ran("call", "/dock", "-").code == 0
    assert ran("call", "/navigate", "--lane", "cancel_goal").code == 0
    assert engine.commands == [
        ("call", DOCK.key, "", ""),
        ("call", DOCK.key, "{speed: 1}", ""),
        ("call", DOCK.key, "speed: 2\n", ""),
        ("call", NAVIGATE.key, "", "cancel_goal"),
    ]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("/navigate",), CallProblem.LANE_MISSING(topic="/navigate", lanes="send_goal, cancel_goal")),
        (
            ("/navigate", "--lane", "send_gaol"),
            CallProblem.LANE_UNKNOWN(
                topic="/navigate", lane="send_gaol", hint="; did you mean send_goal?", lanes="send_goal, cancel_goal"
            ),
        ),
        (("/dock", "--lane", "send_goal"), CallProblem.NO_LANES(topic="/dock")),
    ],
)
def test_which_service_is_called_has_to_be_clear(
    ran: Any, engine: ScriptedEngine, words: tuple[str, ...], why: str
) -> None:
    refused = ran("call", *words)
    assert (refused.code, why in refused.err) == (2, True)
    assert engine.commands == []


def test_a_call_without_an_answer_fails(ran: Any, engine: ScriptedEngine) -> None:
    for future in (engine.called, engine.called_whole):
        future.set_exception(EngineError("/dock: late"))
    failed = ran("call", "/dock")
    assert (failed.code, failed.err) == (1, "rsb-console: /dock: late\n")
    assert ran("call", "/dock", "--json").json == {"ok": False, "error": "/dock: late"}


def test_request_that_no_node_takes_is_wrong_usage(ran: Any, engine: ScriptedEngine) -> None:
    """For example a misspelt field: the bridge's text reaches the command with its kind."""
    engine.called.set_exception(InvalidRequestError("there is no field 'spped': did you mean speed?"))
    refused = ran("call", "/dock", "{spped: 1}")
    assert refused.code == 2
    assert "speed" in refused.err


def test_a_cut_answer_is_an_error_for_programs(ran: Any, engine: ScriptedEngine) -> None:
    """The rest would be missing without a word."""
    engine.called_whole = answered(whole_answer("ab" * 16, b"\0\1\0\0\1"))
    done = ran("call", "/dock", "--json")
    assert (done.code, done.json["ok"], done.json["response"]) == (1, False, {"success": True})
    assert says(done.json["error"], CallProblem.CUT, topic="/dock")
    assert done.json["goal_id"] == "ab" * 16
