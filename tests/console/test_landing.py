"""Reports of a topic's other sides about messages by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from tests.console.scripted import ScriptedEngine, call_route, route
from tests.support.wording import says

from rsb_bridge.model.snapshot import Ledger, RouteSnapshot, Snapshot
from rsb_console.session.manual_messages import Landing, LandingText

ROUTE = route("/cmd", outgoing=True, ledger=Ledger(offered=7, delivered=5, dropped={"disarmed": 2}), latency_p50=0.012)
LINKS = ("robot1",)


def snapshot(*routes: RouteSnapshot) -> Snapshot:
    return replace(ScriptedEngine().now, routes=routes)


@pytest.mark.parametrize(
    ("changes", "ok", "text", "parameters"),
    [
        ({"ledger": Ledger(8, 6, dropped={"disarmed": 2}), "subscribers": ("motors", "log")}, True,
         LandingText.DELIVERED, {"age": ", 12 ms old", "subscribers": "subscribed by motors and log"}),
        ({"ledger": Ledger(8, 6, dropped={"disarmed": 2}), "latency_p50": None}, True,
         LandingText.DELIVERED, {"age": "", "subscribers": "no subscription there"}),
        ({"ledger": Ledger(8, 5, dropped={"disarmed": 3})}, False, LandingText.DROPPED, {"cause": "disarmed"}),
        ({"ledger": Ledger(8, 5, expired=1, dropped={"disarmed": 2})}, False,
         LandingText.DROPPED, {"cause": "too old"}),
    ],
)  # fmt: skip
def test_a_report_of_a_message(
    changes: dict[str, Any], ok: bool, text: LandingText, parameters: dict[str, str]
) -> None:
    landing = Landing("/cmd", snapshot(ROUTE))
    now = snapshot(replace(ROUTE, **changes))
    assert landing.is_known(now, LINKS)
    ((is_ok, report),) = landing.reports(now, LINKS)
    assert is_ok is ok
    assert says(report, text, link="robot1", **parameters)


def test_without_a_report_it_says_so() -> None:
    landing = Landing("/cmd", snapshot(ROUTE))
    assert not landing.is_known(snapshot(ROUTE), LINKS)
    assert landing.reports(snapshot(ROUTE), LINKS)[0][0] is False
    assert landing.is_known(snapshot(ROUTE), ())


def test_each_link_reports_for_itself() -> None:
    other = replace(ROUTE, key="other", link="robot2")
    landing = Landing("/cmd", snapshot(ROUTE, other))
    now = snapshot(replace(ROUTE, ledger=replace(ROUTE.ledger, delivered=6)), other)
    assert landing.is_known(now, LINKS)
    assert not landing.is_known(now, ("robot1", "robot2"))
    assert [ok for ok, _ in landing.reports(now, ("robot1", "robot2"))] == [True, False]


def test_routes_that_are_new_and_those_of_other_topics() -> None:
    landing = Landing("/cmd", snapshot())
    others = (route("/other", outgoing=True), route("/cmd", key="back"), call_route("service", "/cmd"))
    assert landing.reports(snapshot(*others), LINKS) == []
    assert landing.is_known(snapshot(replace(ROUTE, ledger=Ledger(1, 1))), LINKS)
