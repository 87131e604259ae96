"""Reports of a topic's other sides about messages by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from tests.console.scripted import ScriptedEngine, call_route, route
from tests.support.wording import says

from rsb_bridge.model.audience import Audience, Deaf
from rsb_bridge.model.snapshot import Ledger, RouteSnapshot, Snapshot
from rsb_extras.driving.landing import HearingText, Landing, LandingText

ROUTE = route("/cmd", outgoing=True, ledger=Ledger(offered=7, delivered=5, dropped={"disarmed": 2}), latency_p50=0.012)
LINKS = ("robot1",)
LANDED = Ledger(8, 6, dropped={"disarmed": 2})
DEAF = Deaf("base", "qos_incompatible", "no way")


def snapshot(*routes: RouteSnapshot) -> Snapshot:
    return replace(ScriptedEngine().now, routes=routes)


@pytest.mark.parametrize(
    ("changes", "ok", "text", "parameters"),
    [
        ({"ledger": LANDED, "audience": Audience(2, ("motors", "log"))}, True,
         LandingText.DELIVERED, {"age": ", 12.0 ms old", "hearing": HearingText.HEARD(nodes="motors and log")}),
        ({"ledger": LANDED, "audience": Audience(1, ("motors", "log"))}, True,
         LandingText.DELIVERED, {"hearing": HearingText.HEARD_BY_SOME(count=1, nodes="motors and log")}),
        ({"ledger": LANDED, "audience": Audience(0, (), (DEAF,))}, False,
         LandingText.DELIVERED, {"hearing": HearingText.NOT_HEARD(node="base", reason="no way")}),
        ({"ledger": LANDED, "latency_p50": None}, False,
         LandingText.DELIVERED, {"age": "", "hearing": HearingText.NO_SUBSCRIPTION()}),
        ({"ledger": LANDED, "latency_p50": -0.0007, "latency_uncertainty": 0.002}, False,
         LandingText.DELIVERED, {"age": ", <2.0 ms old"}),
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
    (landed,) = landing.reports(now, LINKS)
    assert landed.is_heard is ok
    assert says(landed.text, text, link="robot1", **parameters)


def test_without_a_report_it_says_so() -> None:
    landing = Landing("/cmd", snapshot(ROUTE))
    assert not landing.is_known(snapshot(ROUTE), LINKS)
    assert not landing.reports(snapshot(ROUTE), LINKS)[0].is_heard
    assert landing.is_known(snapshot(ROUTE), ())


def test_each_link_reports_for_itself() -> None:
    other = replace(ROUTE, key="other", link="robot2")
    landing = Landing("/cmd", snapshot(ROUTE, other))
    now = snapshot(replace(ROUTE, ledger=replace(ROUTE.ledger, delivered=6), audience=Audience(1)), other)
    assert landing.is_known(now, LINKS)
    assert not landing.is_known(now, ("robot1", "robot2"))
    assert [each.is_heard for each in landing.reports(now, ("robot1", "robot2"))] == [True, False]


@pytest.mark.parametrize(("cause", "settled"), [("qos_incompatible", True), ("", False)])
def test_subscriptions_without_a_known_cause_may_still_match(cause: str, settled: bool) -> None:
    landing = Landing("/cmd", snapshot(ROUTE))
    deaf = Audience(0, (), (Deaf("base", cause, ""),))
    now = snapshot(replace(ROUTE, ledger=LANDED, audience=deaf))
    assert landing.is_known(now, LINKS)
    assert landing.is_settled(now, LINKS) is settled


def test_new_routes_and_those_of_other_topics() -> None:
    landing = Landing("/cmd", snapshot())
    others = (route("/other", outgoing=True), route("/cmd", key="back"), call_route("service", "/cmd"))
    assert landing.reports(snapshot(*others), LINKS) == []
    assert landing.is_known(snapshot(replace(ROUTE, ledger=Ledger(1, 1))), LINKS)
