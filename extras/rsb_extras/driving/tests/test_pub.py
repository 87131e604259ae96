"""The command ``pub``: messages by hand through a running bridge, their results, and tickets."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from msgspec import structs
from tests.console.scripted import route
from tests.support import replaced, surroundings
from tests.support.commands import rsb_console
from tests.support.wording import says

from rsb_bridge.api import EngineError
from rsb_bridge.model.audience import Audience, Deaf
from rsb_bridge.model.by_hand import OLD_AFTER
from rsb_bridge.model.calls import FIELDS_LENGTH
from rsb_bridge.model.snapshot import ArmingSnapshot, State
from rsb_extras.driving import pub_command
from rsb_extras.driving.landing import REPORTED_WITHIN, ByHandText, LandingText
from rsb_extras.driving.pub_command import _LOOK_EVERY, PubText
from rsb_extras.driving.publish_requests import Draft, Published
from rsb_extras.driving.tests import driving_places
from rsb_extras.driving.tests.publishing_engine import PublishingEngine

if TYPE_CHECKING:
    from tests.support.control import Machine

    from rsb_extras.driving.publish_requests import Publish

STRING = "std_msgs/msg/String"
TAKEN = Published(is_done=True, ticket=5, type_name=STRING, audience=Audience(1, ("/log",)), links=("robot1",))
ALONE = Published(is_done=True, ticket=6, type_name=STRING)
OLD = Published(is_done=False, ticket=7, type_name=STRING)


@pytest.fixture
def engine(machine: Machine, here: None) -> PublishingEngine:
    return machine.have(PublishingEngine())


@pytest.fixture
def ran(ran: Any) -> Any:
    return partial(ran, "pub")


class Clock:
    """The module `time` and the clock of the command: waits take no time, and are recorded."""

    def __init__(self) -> None:
        self.now = 100.0
        self.slept: list[float] = []
        self.most = 1000

    def steady(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds
        if len(self.slept) >= self.most:
            raise KeyboardInterrupt


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    driving_places.PUB_TIME.set(monkeypatch, made)
    replaced.STEADY_CLOCK.set(monkeypatch, staticmethod(made.steady))
    return made


def sent(engine: PublishingEngine) -> list[Publish]:
    return [command[1] for command in engine.commands if command[0] == "publish"]  # type: ignore[misc]


def test_one_message(ran: Any, engine: PublishingEngine) -> None:
    engine.published = [TAKEN]
    done = ran("/words", "data: hello")
    assert (done.code, done.err) == (0, "")
    assert says(done.out, PubText.PUBLISHED, topic="/words", type_name=STRING)
    (command,) = sent(engine)
    assert (command.topic, command.fields, command.type_name) == ("/words", "data: hello", "")
    assert (command.ticket, command.rest) == (0, "")


def test_message_from_standard_input_with_new_topics_type(
    ran: Any, engine: PublishingEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine.published = [TAKEN]
    surroundings.set_stdin(monkeypatch, "data: hello\n")
    assert ran("/words", "-", "--type", STRING).code == 0
    assert [(each.fields, each.type_name) for each in sent(engine)] == [("data: hello\n", STRING)]


def test_standard_input_is_read_up_to_message_limit(
    ran: Any, engine: PublishingEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine.published = [EngineError("too long")]
    surroundings.set_stdin(monkeypatch, "#" * (2 * FIELDS_LENGTH))
    assert ran("/words", "-").code == 1
    assert [len(each.fields) for each in sent(engine)] == [FIELDS_LENGTH + 1]


@pytest.mark.parametrize(("options", "every"), [((), 1.0), (("--rate", "4"), 0.25)])
def test_some_messages_once_second_or_at_rate(
    ran: Any, engine: PublishingEngine, clock: Clock, options: tuple[str, ...], every: float
) -> None:
    engine.published = [TAKEN] * 3
    done = ran("/words", "data: hello", "--count", "3", *options)
    assert done.code == 0
    assert len(done.out.splitlines()) == 1
    assert [each.ticket for each in sent(engine)] == [0, 5, 5]
    assert clock.slept == [every] * 2


@pytest.mark.parametrize(
    ("rate", "armed", "on_end", "end"),
    [
        ("10", True, "zero", ("{}", 0.5)),
        ("2", True, "zero", ("{}", 1.0)),
        ("10", True, '{"x": 1}', ('{"x": 1}', 0.5)),
        ("10", True, "none", ("", 0.5)),
        ("10", False, "zero", ("", 0.5)),
        ("0.5", True, "zero", ("", 0.5)),
    ],
)
def test_messages_at_rate_end_with_what_stops_robot(
    rate: str, armed: bool, on_end: str, end: tuple[str, float], ran: Any, engine: PublishingEngine, clock: Clock
) -> None:
    """The engine publishes it, so that it comes even if the command is killed."""
    arming = ArmingSnapshot(armed=armed, on_end=on_end)
    engine.now = replace(engine.now, routes=(route("/words", outgoing=True, max_age=1.0, arming=arming),))
    engine.published = [TAKEN] * 2
    assert ran("/words", "data: go", "--count", "2", "--rate", rate).code == 0
    assert {(each.rest, each.rest_after) for each in sent(engine)} == {end}


def test_late_messages_are_not_made_up_for(
    ran: Any, engine: PublishingEngine, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine.published = [TAKEN] * 4
    publish = pub_command.publish

    def slowly(*arguments: Any) -> Published:
        clock.now += 1.0 if not sent(engine) else 0.0
        return publish(*arguments)

    driving_places.PUB_PUBLISH.set(monkeypatch, slowly)
    assert ran("/words", "", "--count", "4", "--rate", "4").code == 0
    assert clock.slept == [0.0, 0.25, 0.25]


def test_without_count_rate_lasts_until_it_is_interrupted(engine: PublishingEngine, clock: Clock) -> None:
    clock.most = 7
    engine.published = [TAKEN] * 7
    done = rsb_console("pub", "/words", "data: hello", "--rate", "10")
    assert done.returncode == 130
    assert len(sent(engine)) == 7
    assert len(done.stdout.splitlines()) == 1


@pytest.mark.parametrize("options", [(), ("--count", "1"), ("--rate", "10", "--count", "1")])
def test_after_the_last_message_it_does_not_wait(
    ran: Any, engine: PublishingEngine, clock: Clock, options: tuple[str, ...]
) -> None:
    engine.published = [TAKEN]
    assert len(ran("/words", "", *options).out.splitlines()) == 1
    assert clock.slept == []


def test_where_it_does_not_go_is_named(ran: Any, engine: PublishingEngine) -> None:
    down = route("/words", State.DOWN, outgoing=True, link="robot2", reason="no link \x1b[2J")
    engine.now = replace(engine.now, routes=(down,))
    engine.published = [TAKEN]
    done = ran("/words", "data: hello")
    assert done.code == 0
    assert says(done.err, PubText.NOT_OVER, link="robot2")
    assert "\x1b" not in done.err


def test_nobody_gets_it(ran: Any, engine: PublishingEngine) -> None:
    engine.published = [ALONE]
    done = ran("/words", "data: hello")
    assert (done.code, done.out) == (1, "")
    assert says(done.err, PubText.NOBODY, topic="/words")
    engine.published = [ALONE]
    done = ran("/words", "", "--json")
    assert (done.code, done.json["ok"], done.json["count"]) == (1, False, 1)


def test_the_result_for_programs(ran: Any, engine: PublishingEngine, clock: Clock) -> None:
    routes = (
        route("/words", State.DOWN, key="2", outgoing=True, link="robot2", reason="no link"),
        route("/words", key="3", link="robot3"),
        route("/other", key="4", outgoing=True, link="robot4"),
        route("/words", outgoing=True),
    )
    engine.now = replace(engine.now, routes=routes)
    engine.published = [TAKEN] * 2
    done = ran("/words", "data: hello", "--count", "2", "--json")
    assert done.code == 0
    assert done.json == {
        "ok": True,
        "topic": "/words",
        "type": STRING,
        "count": 2,
        "subscriptions": 1,
        "heard_by": ["/log"],
        "deaf": [],
        "links": ["robot1"],
        "not_over": [{"link": "robot2", "state": "down", "reason": "no link"}],
        "landed": [
            {
                "link": "robot1",
                "ok": False,
                "report": LandingText.UNREPORTED(link="robot1", seconds=REPORTED_WITHIN),
                "heard_by": [],
                "deaf": [],
            }
        ],
    }
    assert [each for each in clock.slept if each > _LOOK_EVERY] == [1.0]


DEAF = Deaf("/base", "qos_incompatible", "no way")


@pytest.mark.parametrize(
    ("near", "far", "code"),
    [
        (Audience(), Audience(), 1),
        (Audience(), Audience(deaf=(DEAF,)), 1),
        (Audience(deaf=(DEAF,)), Audience(), 1),
        (Audience(1), Audience(deaf=(DEAF,)), 0),
        (Audience(), Audience(1, ("/base",)), 0),
    ],
)
def test_the_exit_code_says_whether_anybody_hears(
    ran: Any,
    engine: PublishingEngine,
    clock: Clock,
    monkeypatch: pytest.MonkeyPatch,
    near: Audience,
    far: Audience,
    code: int,
) -> None:
    words = route("/words", outgoing=True)
    delivered = replace(words.ledger, delivered=words.ledger.delivered + 1)
    publish = pub_command.publish

    def published(*arguments: Any) -> Published:
        engine.now = replace(engine.now, routes=(replace(words, ledger=delivered, audience=far),))
        return publish(*arguments)

    driving_places.PUB_PUBLISH.set(monkeypatch, published)
    for options in ((), ("--json",)):
        engine.now = replace(engine.now, routes=(words,))
        engine.published = [structs.replace(TAKEN, audience=near)]
        done = ran("/words", "data: hello", *options)
        assert done.code == code
    assert done.json["ok"] is (code == 0)
    (landed,) = done.json["landed"]
    assert (landed["ok"], landed["heard_by"]) == (far.count > 0, list(far.nodes))
    assert [each["cause"] for each in landed["deaf"]] == [each.cause for each in far.deaf]
    assert [each["node"] for each in done.json["deaf"]] == [each.node for each in near.deaf]


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_a_refusal(ran: Any, engine: PublishingEngine, options: tuple[str, ...]) -> None:
    engine.published = [EngineError("no luck \x1b[2J")]
    done = ran("/words", "data: hello", *options)
    assert done.code == 1
    assert "no luck" in done.out + done.err
    assert "\x1b" not in done.out + done.err


@pytest.mark.parametrize(
    "arguments",
    [
        ("/words",),
        (),
        ("/words", "", "--rate", "0"),
        ("/words", "", "--rate", "101"),
        ("/words", "", "--rate", "nan"),
        ("/words", "", "--count", "0"),
        ("/words", "", "--count", "-1"),
    ],
)
def test_wrong_usage(engine: PublishingEngine, arguments: tuple[str, ...]) -> None:
    assert rsb_console("pub", *arguments).returncode == 2
    assert engine.commands == []


def test_a_new_ticket_for_each_message(ran: Any, engine: PublishingEngine, clock: Clock) -> None:
    """Once a second, each ticket may have become too old."""
    engine.published = [OLD, TAKEN, OLD, TAKEN]
    assert ran("/cmd_vel", "", "--count", "2").code == 0
    assert [each.ticket for each in sent(engine)] == [0, 7, 5, 7]
    assert len(clock.slept) == 1


def test_a_bridge_that_answers_too_slowly(ran: Any, engine: PublishingEngine) -> None:
    engine.published = [OLD, OLD, OLD, TAKEN]
    done = ran("/cmd_vel", "")
    assert done.code == 1
    assert says(done.err, ByHandText.TOO_SLOW, topic="/cmd_vel")
    assert len(sent(engine)) == 3


def test_a_slow_start_makes_no_message_old(machine: Machine, engine: PublishingEngine) -> None:
    """A small computer takes longer to load the program than a command may be old."""
    engine.published = [OLD, TAKEN]
    words = ["rsb-console", "pub", "/words", "data: hello", "--rate", "10", "--count", "1"]
    starts = f"import sys, time\ntime.sleep({OLD_AFTER + 0.1})\nfrom rsb_console.cli import main\n"
    script = f"{starts}sys.argv = {words}\nsys.exit(main())"
    environ = {**os.environ, **machine.environ}
    done = subprocess.run([sys.executable, "-c", script], env=environ, capture_output=True, timeout=180, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert [each.ticket for each in sent(engine)] == [0, 7]


def test_a_message_to_begin_with(ran: Any, engine: PublishingEngine) -> None:
    engine.drafts["/words"] = Draft(STRING, "data: ''\n")
    done = ran("/words", "--template")
    assert (done.code, done.out, done.err) == (0, "data: ''\n", "")
    engine.drafts["/words"] = Draft(STRING, "data: hello\n", is_last=True)
    done = ran("/words", "--template", "--type", STRING, "--json")
    assert done.json == {"ok": True, "type": STRING, "message": "data: hello\n", "is_last": True}
    assert engine.commands == [("draft", "/words", ""), ("draft", "/words", STRING)]


def test_no_message_to_begin_with(ran: Any, engine: PublishingEngine) -> None:
    done = ran("/words", "--template")
    assert (done.code, done.out) == (1, "")
    assert "\x1b" not in done.err
