"""A peer that holds the key and tries everything to run something else, or more, or at another time: nothing runs."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.link.foreign_proposals_helpers import link, rogue
from tests.support.bridge import happened
from tests.support.inside import inside
from tests.support.waiting import eventually
from tests.wire.document_helpers import documented_fields

from rsb_bridge.feature import MAY
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.snapshot import State
from rsb_bridge.wire.protocol_error import Broken
from rsb_extras import units
from rsb_extras.units.link_units import AskUnits, RunUnit, UnitAnswer, UnitEnded
from rsb_extras.units.tests.supervised import Supervised, has, may, waiting
from rsb_extras.units.tests.units_places import ASKED_WITHIN, TICKET_LIFE
from rsb_extras.units.unit_records import UnitOutcome, UnitRecord
from rsb_extras.units.unit_runner import STARTS, UnitCode

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.support.bridge import Bridge
    from tests.support.rogue import Rogue

    from rsb_bridge.engine import Engine


class Bed:
    """A bridge with a unit that its peer may ask for, and one that it may not.

    Attributes:
        nav: the one that it may ask for.
    """

    def __init__(self, bridge: Bridge, folder: Path) -> None:
        self.nav, self.lidar = Supervised(folder / "nav"), Supervised(folder / "lidar")
        self._bridge = bridge

    def start(self) -> Engine:
        return self._bridge.server(features=has(("nav", self.nav), ("lidar", self.lidar), **{MAY: may("nav")}))

    @property
    def ran(self) -> list[str]:
        return self.nav.ran + self.lidar.ran

    def close(self) -> None:
        self.nav.close()
        self.lidar.close()


@pytest.fixture
def bed(bridge: Bridge, tmp_path: Path) -> Iterator[Bed]:
    made = Bed(bridge, tmp_path)
    yield made
    made.close()


def ticket(peer: Rogue, request: int = 1) -> int:
    peer.say(AskUnits(request, ticket=True))
    return peer.wait_for(UnitAnswer).ticket


def outcome(peer: Rogue, unit: str, action: Any = "restart", number: int | None = None) -> UnitOutcome:
    """Return the answer to a request with a number, or with a new ticket."""
    peer.say(RunUnit(unit, action, ticket=ticket(peer) if number is None else number, who="anna"))
    return peer.wait_for(UnitEnded).outcome


def test_the_page_documents_each_field() -> None:
    from pathlib import Path

    page = (Path(units.__file__).with_name("docs") / "units-protocol.md").read_text(encoding="utf-8")
    kinds = (AskUnits, UnitAnswer, UnitRecord, RunUnit, UnitEnded, UnitOutcome)
    assert documented_fields(page) == {
        each.__name__: {field.name for field in msgspec.structs.fields(each)} for each in kinds
    }


def test_what_it_may_not_ask_for_is_refused(bridge: Bridge, bed: Bed) -> None:
    server = bed.start()
    with rogue(bridge) as peer:
        for unit in ("lidar", "none", "", "NAV", "nav-", "-nav", "_"):
            assert outcome(peer, unit).refused, unit
        assert happened(server, UnitCode.REFUSED, "unit lidar: restart refused: the server does not let robot1")
    assert bed.ran == []


@pytest.mark.parametrize(
    "broken",
    [
        {"unit": "../nav"}, {"unit": "/bin/sh"}, {"unit": "nav; reboot"}, {"unit": "nav\0"}, {"unit": "nav\n"},
        {"unit": "x" * 64}, {"unit": ["sh", "-c", "id"]}, {"action": "status"}, {"action": "log"}, {"action": "exec"},
        {"action": ["restart"]}, {"who": "\x1b[2J"}, {"who": "x" * 256}, {"ticket": -1}, {"ticket": 2**60},
        {"ticket": True}, {"ticket": "1"}, {"again": 1},
    ],
)  # fmt: skip
def test_requests_out_of_bounds_end_the_link(bridge: Bridge, bed: Bed, broken: dict[str, Any]) -> None:
    server = bed.start()
    with rogue(bridge) as peer:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        said = msgspec.to_builtins(RunUnit("nav", "restart", ticket=ticket(peer)))
        peer.say_raw(msgspec.msgpack.encode(said | broken))
        eventually(lambda: server.snapshot().links[0].state is not State.OK, what="the end of the link")
        assert happened(server, EventCode.LINK_LOST, Broken.INVALID_CONTROL_MESSAGE)
    assert bed.ran == []


def test_words_of_the_peer_run_nothing(bridge: Bridge, bed: Bed) -> None:
    """A decoder leaves out what a message has besides, as a newer peer may add a field; none of it is ever used."""
    bed.start()
    with rogue(bridge) as peer:
        said = msgspec.to_builtins(RunUnit("lidar", "restart", ticket=ticket(peer)))
        words = {"restart": ["touch", "made"], "words": ["touch", "made"], "command": "touch made", "env": {"A": "b"}}
        peer.say_raw(msgspec.msgpack.encode(said | words | {"cwd": "/tmp", "timeout": 1e9, "allowed": True}))
        assert peer.wait_for(UnitEnded).outcome.refused
    assert bed.ran == []


def test_each_ticket_counts_once(bridge: Bridge, bed: Bed) -> None:
    bed.start()
    with rogue(bridge) as peer:
        numbers = [ticket(peer, request) for request in range(1, 6)]
        for number in (0, numbers[0], numbers[-1] + 1, 2**53):
            assert outcome(peer, "nav", number=number).refused, number
        assert bed.ran == []
        peer.say(*[RunUnit("nav", "restart", ticket=numbers[-1])] * 50)
        assert peer.wait_for(UnitEnded).outcome.done
        assert outcome(peer, "nav", "stop", number=numbers[-1]).done, "the end of the one action"
    assert bed.ran == ["restart"]


def test_lists_leave_a_ticket_as_it_is(bridge: Bridge, bed: Bed) -> None:
    bed.start()
    with rogue(bridge) as peer:
        number = ticket(peer)
        peer.say(AskUnits(2))
        assert peer.wait_for(UnitAnswer).ticket == 0
        assert outcome(peer, "nav", number=number).done
    assert bed.ran == ["restart"]


def test_a_ticket_of_another_connection_is_void(bridge: Bridge, bed: Bed) -> None:
    bed.start()
    with rogue(bridge) as peer:
        number = ticket(peer)
    with rogue(bridge) as peer:
        for again in (False, True):
            peer.say(RunUnit("nav", "restart", ticket=number, again=again))
            ended = peer.wait_for(UnitEnded).outcome
            assert not ended.done
            assert ended.refused is not again, "given again, it may have run before a restart"
    assert bed.ran == []


def test_a_request_that_was_held_up_is_void(bridge: Bridge, bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
    TICKET_LIFE.set(monkeypatch, 0.0)
    bed.start()
    with rogue(bridge) as peer:
        assert outcome(peer, "nav").reason == "the request came too late, and nothing was done: ask again"
    assert bed.ran == []


def test_one_at_a_time_and_few_a_minute(bridge: Bridge, bed: Bed) -> None:
    go = waiting(bed.nav.folder)
    bed.nav.unit = msgspec.structs.replace(bed.nav.unit, start=go, restart=("true",), status=())
    bed.start()
    with rogue(bridge) as peer:
        peer.say(RunUnit("nav", "start", ticket=ticket(peer)))
        eventually(lambda: bed.ran, what="a command that runs")
        for request in range(3):
            number = ticket(peer, request + 2)
            peer.say(RunUnit("nav", "start", ticket=number))
            assert peer.wait_for(UnitEnded).outcome.refused
        assert bed.ran == ["waits"]
        (bed.nav.folder / "go").touch()
        assert peer.wait_for(UnitEnded).outcome.done
        done = [outcome(peer, "nav").done for _ in range(STARTS + 3)]
    assert done == [True] * (STARTS - 1) + [False] * 4


def test_refused_requests_do_not_fill_the_log(bridge: Bridge, bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
    ASKED_WITHIN.set(monkeypatch, 1e6)
    server = bed.start()
    with rogue(bridge) as peer:
        assert all(outcome(peer, "other").refused for _ in range(20))
    assert sum(each.code == UnitCode.REFUSED for each in server.events()) == 12


def test_looks_are_bounded(bridge: Bridge, bed: Bed) -> None:
    """However often a peer asks, a status is asked for every 5 s."""
    status = ("sh", "-c", f"echo status >> {bed.nav.folder}/ran; exit 3")
    bed.nav.unit = msgspec.structs.replace(bed.nav.unit, status=status)
    server = bed.start()
    began = inside(server).context.now()
    with rogue(bridge) as peer:
        peer.say(*(AskUnits(request) for request in range(1, 9)))
        for _ in range(8):
            peer.wait_for(UnitAnswer)
    spent = inside(server).context.now() - began
    assert 1 <= len(bed.nav.ran) <= 1 + spent / 5


def test_a_flood_ends_nothing_else(bridge: Bridge, bed: Bed) -> None:
    server = bed.start()
    with rogue(bridge) as peer:
        peer.say(*(RunUnit("nav", "restart", ticket=number, who="x" * 255) for number in range(1000)))
        deadline = time.monotonic() + 60
        answers = 0
        while answers < 1000 and time.monotonic() < deadline:
            assert peer.wait_for(UnitEnded).outcome.refused
            answers += 1
        assert answers == 1000
        assert outcome(peer, "nav").done
    assert bed.ran == ["restart"]
    assert len([event for event in server.events() if event.code in [*UnitCode]]) == 2


def test_lies_about_units_reach_no_operator(bridge: Bridge, bed: Bed) -> None:
    """An answer that nobody has asked for, of another request, or twice, changes nothing."""
    server = bed.start()
    with rogue(bridge) as peer:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        peer.say(UnitAnswer(1, 1, (UnitRecord("mine", ("restart",)),)), UnitEnded(1, UnitOutcome()))
        peer.say(UnitEnded(0, UnitOutcome(reason="x")))
        assert outcome(peer, "nav").done
        assert link(server).linked


@pytest.mark.parametrize(
    "broken",
    [
        {"units": [{"name": "a/b"}]}, {"units": [{"name": "a", "state": "on fire"}]},
        {"units": [{"name": "a", "age": -1.0}]}, {"units": [{"name": "a", "actions": ["exec"]}]},
        {"units": [{"name": "a", "actions": ["start"] * 4}]}, {"units": [{"name": "a"}] * 33}, {"ticket": 2**60},
    ],
)  # fmt: skip
def test_answers_out_of_bounds_end_the_link(bridge: Bridge, bed: Bed, broken: dict[str, Any]) -> None:
    _breaks(bed.start(), bridge, msgspec.to_builtins(UnitAnswer(1, 1)) | broken)


@pytest.mark.parametrize(
    "broken",
    [
        {"output": ["x"] * 65}, {"output": ["x" * 256]}, {"log": ["\x1b[2J"]}, {"reason": "x" * 501},
        {"reason": "a\nb"}, {"seconds": -1.0}, {"state": ""}, {"refused": 1},
    ],
)  # fmt: skip
def test_outcomes_out_of_bounds_end_the_link(bridge: Bridge, bed: Bed, broken: dict[str, Any]) -> None:
    said = msgspec.to_builtins(UnitEnded(1, UnitOutcome()))
    _breaks(bed.start(), bridge, said | {"outcome": broken})


def _breaks(server: Engine, bridge: Bridge, said: dict[str, Any]) -> None:
    with rogue(bridge) as peer:
        eventually(lambda: server.snapshot().links[0].state is State.OK, what="a link")
        peer.say_raw(msgspec.msgpack.encode(said))
        eventually(lambda: server.snapshot().links[0].state is not State.OK, what="the end of the link")
        assert happened(server, EventCode.LINK_LOST, Broken.INVALID_CONTROL_MESSAGE)
