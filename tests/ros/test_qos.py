"""QoS matching in words, held against the middleware's own verdict."""

from __future__ import annotations

from itertools import product

import pytest
from rclpy.qos import QoSCompatibility, qos_check_compatible

from rsb_bridge.model.qos import (
    PROFILES,
    Durability,
    Liveliness,
    Qos,
    QosMismatch,
    Reliability,
    incompatible,
    match_publishers,
    match_subscriptions,
)
from rsb_bridge.ros.native.rcl_conversions import rcl_profile

RELIABILITIES: tuple[Reliability, ...] = ("reliable", "best_effort")
DURABILITIES: tuple[Durability, ...] = ("volatile", "transient_local")
KINDS: tuple[Liveliness, ...] = ("automatic", "manual_by_topic")
TIMES = (0.0, 1.0, 2.0)
POLICIES = [
    *(Qos(each, durability, deadline=time) for each, durability, time in product(RELIABILITIES, DURABILITIES, TIMES)),
    *(Qos(liveliness=kind, liveliness_lease_duration=lease) for kind, lease in product(KINDS, TIMES)),
]


MANUAL = Qos(liveliness="manual_by_topic", liveliness_lease_duration=1.0)


@pytest.mark.parametrize("offered", POLICIES)
def test_incompatible_agrees_with_the_middleware(offered: Qos) -> None:
    for requested in POLICIES:
        verdict, why = qos_check_compatible(rcl_profile(offered), rcl_profile(requested))
        assert bool(incompatible(offered, requested)) == (verdict == QoSCompatibility.ERROR), (requested, why)


def test_incompatible_says_every_reason() -> None:
    offered = Qos(reliability="best_effort", deadline=2.0)
    requested = Qos(durability="transient_local", deadline=1.0)
    deadlines = [QosMismatch.DEADLINE(seconds=seconds) for seconds in (2, 1)]
    pairs = ("best_effort", "reliable"), ("volatile", "transient_local"), deadlines
    assert incompatible(offered, requested) == "; ".join(
        QosMismatch.POLICY(offer=offer, request=request) for offer, request in pairs
    )
    assert incompatible(Qos(), Qos(deadline=1.5)) == QosMismatch.POLICY(
        offer=QosMismatch.NO_DEADLINE(), request=QosMismatch.DEADLINE(seconds=1.5)
    )


@pytest.mark.parametrize(
    ("offered", "matched"),
    [
        ([], Qos()),
        ([PROFILES["sensor_data"]], Qos(reliability="best_effort")),
        ([PROFILES["latched"], PROFILES["latched"]], Qos(durability="transient_local")),
        ([PROFILES["latched"], PROFILES["default"]], Qos()),
        ([PROFILES["default"], PROFILES["sensor_data"]], Qos(reliability="best_effort")),
        ([Qos(deadline=1.0, lifespan=3.0), Qos(deadline=2.0)], Qos(deadline=2.0)),
        ([MANUAL, MANUAL], MANUAL),
        ([MANUAL, Qos(liveliness_lease_duration=2.0)], Qos(liveliness_lease_duration=2.0)),
        ([MANUAL, Qos()], Qos()),
    ],
)
def test_match_publishers(offered: list[Qos], matched: Qos) -> None:
    assert match_publishers(offered) == matched
    assert not any(incompatible(each, matched) for each in offered)


@pytest.mark.parametrize("requested", [[MANUAL, Qos()], [MANUAL, Qos(liveliness_lease_duration=0.5)]])
def test_match_subscriptions_offers_each_its_liveliness(requested: list[Qos]) -> None:
    assert not any(incompatible(match_subscriptions(requested), each) for each in requested)


@pytest.mark.parametrize("absurd", [Qos(depth=0), Qos(depth=2**70), Qos(deadline=1e300), Qos(lifespan=float("nan"))])
def test_no_figure_of_a_peer_upsets_ros(absurd: Qos) -> None:
    assert 1 <= rcl_profile(absurd).depth < 2**31
