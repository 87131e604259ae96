"""Nothing unmeant and nothing old reaches a robot: real programs, real nodes, counted at the robot's own node.

A part of what ``python -m tests.system.torture all`` does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.support.locks import domains_of
from tests.support.long import long, long_cases
from tests.system.torture import attacks, rests
from tests.system.torture.ends import WITNESS, Arrival
from tests.system.torture.judge import Window, judge
from tests.system.torture.stage import TOPIC, Nodes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.system.torture.attacks import Attack
    from tests.system.torture.judge import Findings
    from tests.system.torture.stage import Stage, Transport


@pytest.fixture(scope="module")
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """The ROS nodes of all these tests."""
    made = Nodes.start(tmp_path_factory.mktemp("torture"), domains_of("programs"))
    yield made
    made.close()


def check(found: Findings) -> None:
    """Messages have crossed, and none that should not have."""
    assert found.crossed
    assert found.wrong == found.in_hand, found
    assert found.in_hand <= 1, found
    assert not [each for each in found.notes if each.startswith(attacks.NOT_AGAIN)], found


def _freeze_robot(stage: Stage) -> None:
    attacks.freeze_robot(stage, 2.5)


def _freeze_pc(stage: Stage) -> None:
    attacks.freeze_pc(stage, 2.5)


@pytest.mark.parametrize(
    ("name", "transport", "attack"),
    [
        ("freeze-robot", "tcp", _freeze_robot),
        ("freeze-pc", "udp", _freeze_pc),
        ("hold", "udp", attacks.hold(("data", "datagrams", "control"), 2.0)),
        ("hold-control-first", "tcp", attacks.hold(("control", "data"), 2.0)),
        *long_cases(("freeze-robot", "udp", _freeze_robot), ("freeze-pc", "tcp", _freeze_pc), ("add-up", "tcp", None)),
    ],
)
def test_nothing_old_reaches_the_robot(nodes: Nodes, name: str, transport: Transport, attack: Attack | None) -> None:
    check(attacks.attack(nodes, name, transport, attack))


@pytest.mark.parametrize("name", ["disarm-held", "disarm-data-held", *long("disarm-frozen", "disarm-0.4s")])
def test_nothing_reaches_robot_after_disarming_is_told(nodes: Nodes, name: str) -> None:
    check(attacks.attack(nodes, name, "tcp"))


@pytest.mark.parametrize(
    ("name", "transport", "driver"),
    [
        ("cut", "udp", "node"),
        ("pc: disarm", "tcp", "hand"),
        ("robot: SIGTERM", "tcp", "hand on robot"),
        *long_cases(
            ("pc: kill -9", "zenoh", "node"), ("router stopped", "zenoh", "hand"), ("robot: edit", "udp", "hand")
        ),
    ],
)
def test_last_message_at_robot_rests(nodes: Nodes, name: str, transport: Transport, driver: rests.Driver) -> None:
    """When it comes is for `python -m tests.system.torture rests`, on a machine with nothing else to do."""
    found = rests.run(nodes, name, transport, driver)
    assert (found.last, found.moving_after_rest) == ("rest", 0), found


def test_the_judge_is_not_blind() -> None:
    window = Window(10.0, 20.0)
    witness = [Arrival(WITNESS, 1, 10.0, 10.01, 10.01), Arrival(WITNESS, 2, 20.0, 20.01, 20.01)]

    def judged(published: float, arrived: float) -> tuple[int, int, int]:
        found = judge([*witness, Arrival(TOPIC, 1, published, arrived, arrived)], [window, Window(30.0)])
        return found.old, found.after, found.unarmed

    assert judged(11.0, 12.0) == (0, 0, 0)
    assert judged(11.0, 12.1) == (1, 0, 0)
    assert judged(19.9, 20.02) == (0, 0, 0)
    assert judged(19.9, 20.1) == (0, 1, 0)
    assert judged(19.9, 31.0) == (1, 1, 0)
    assert judged(9.9, 10.1) == (0, 0, 1)
    assert judged(20.2, 20.3) == (0, 0, 1)
    assert judged(29.9, 30.1) == (0, 0, 1)
    assert judged(30.1, 40.0) == (1, 0, 0)
    assert judged(30.1, 30.9) == (0, 0, 0)


def test_the_judge_excuses_what_was_in_hand() -> None:
    """As the bridge froze from 12 to 14.5 s; what came while it was frozen has no such excuse."""

    def in_hand(published: float, arrived: float, bridged: float) -> tuple[int, int]:
        arrivals = [Arrival(WITNESS, 1, arrived, arrived, arrived), Arrival(TOPIC, 1, published, arrived, bridged)]
        found = judge(arrivals, [Window(10.0)], frozen=[(12.0, 14.5)])
        return found.wrong, found.in_hand

    assert in_hand(11.99, 14.51, 14.51) == (1, 1)  # it was stamped by DDS after the freeze
    assert in_hand(11.99, 14.51, 12.0) == (1, 1)  # and before
    assert in_hand(11.99, 14.6, 14.6) == (1, 0)  # it was not published at once after that
    assert in_hand(12.5, 14.51, 14.51) == (1, 0)
    assert in_hand(10.9, 14.51, 14.51) == (1, 0)
    assert in_hand(13.4, 14.51, 14.51) == (1, 0)
    assert in_hand(13.6, 14.51, 14.51) == (0, 0)
