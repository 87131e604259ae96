"""The status line of a bridge without a console: what flows with its rate, what doesn't with the reason."""

from dataclasses import replace

from tests.console.scripted import LINK, ScriptedEngine, route

from rsb_bridge.model.snapshot import Ledger, RefusedClient, RouteSnapshot, State
from rsb_console.command.formatting import StatusLines


def parts(*routes: RouteSnapshot) -> list[str]:
    """Return each topic's part of the line."""
    return StatusLines().text(replace(ScriptedEngine().snapshot(), routes=routes)).split(" | ")[3:]


def test_stopped_routes_come_first_with_reason() -> None:
    waiting = route("/scan", State.WAITING, outgoing=True, reason="no publisher of /scan in domain 2", ledger=Ledger())
    stale = route("/map", State.STALE, reason="nothing for 15 s", rate=0.0, ledger=Ledger(dropped={"queue full": 3}))
    paused = route("/goal", State.PAUSED, reason="paused there", ledger=Ledger())
    assert parts(route("/odom", ledger=Ledger()), paused, waiting, stale) == [
        "← /map STALE: nothing for 15 s (3 dropped)",
        "→ /scan WAITING: no publisher of /scan in domain 2",
        "← /goal PAUSED: paused there",
        "← /odom 10.0 Hz",
    ]


def test_what_has_no_room_is_what_flows() -> None:
    flowing = [route(f"/t{number}") for number in range(9)]
    line = parts(*flowing, route("/late", State.DOWN, reason="link lost", ledger=Ledger()))
    assert line[0] == "← /late DOWN: link lost"
    assert line[-1] == "and 2 more"


def test_what_is_wrong_with_link_is_said_once() -> None:
    down = replace(LINK, name="robot2", state=State.DOWN, reason="cable pulled")
    twice = replace(LINK, warning="a namesake at 10.0.0.9")
    routes = [route(f"/t{number}", State.DOWN, link="robot2", reason="cable pulled") for number in range(5)]
    snapshot = replace(ScriptedEngine().snapshot(), links=(twice, down), routes=(*routes, route("/odom")))
    line = StatusLines().text(snapshot)
    assert line.count("cable pulled") == 1
    assert line.split(" | ")[3:] == [
        "robot1 a namesake at 10.0.0.9",
        "robot2 DOWN: cable pulled",
        f"← /odom 10.0 Hz ({route('/odom').ledger.dropped_total} dropped)",
    ]
    assert "6 topics: 5 down, 1 ok" in line


def test_cause_is_told_on_change_once_a_minute() -> None:
    snapshot = replace(ScriptedEngine().snapshot(), links=(LINK,))
    lines = StatusLines()

    def tells(seconds: float, cause: str, since: float) -> bool:
        stale = route("/map", State.STALE, cause=cause, reason=f"CAUSE, for {since:g} s", rate=0.0, ledger=Ledger())
        line = lines.text(replace(snapshot, time=snapshot.time + seconds, routes=(stale, route("/odom"))))
        assert "/map STALE" in line
        assert "/odom 10.0 Hz" in line
        return "CAUSE" in line

    assert [tells(5.0 * turn, "silent", 5.0 * turn) for turn in range(14)] == [True] + [False] * 11 + [True, False]
    assert tells(70.0, "no_publisher", 70.0)
    assert not tells(75.0, "no_publisher", 75.0)


def test_a_refused_client_is_told_once() -> None:
    refused = RefusedClient("robot9", "10.0.0.9", "unknown_name", "CAUSE", 1_700_000_000.0, 3)
    snapshot = replace(ScriptedEngine().snapshot(), refused=(refused,))
    lines = StatusLines()
    assert ["CAUSE" in lines.text(replace(snapshot, time=snapshot.time + 5.0 * turn)) for turn in range(3)] == [
        True, False, False,
    ]  # fmt: skip
