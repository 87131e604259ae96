"""Topics and calls across a failing path, counted by nodes outside of the bridge: `bench.outages` in small."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

import pytest
from tests.network.outage_bed import FAULTS, FLOWS, OutageBed, Record
from tests.network.outage_counts import AccountCounts, CallCounts, count_account, count_calls, count_topic
from tests.network.traffic import WRONG
from tests.support.waiting import eventually

from rsb_bridge.model.codes import EventCode

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.network.conftest import Network

_BACK_WITHIN = 10.0
"""s; on a quiet machine it takes 0.7 (bench/README.md)."""
_MOVED_WITHIN = 4.0  # s; on a quiet machine it takes 1.4, and a link is given up after 5
_S = 10**9


@pytest.fixture
def bed(network: Network, tmp_path: Path) -> Iterator[OutageBed]:
    with OutageBed(tmp_path, "tcp") as made:
        yield made


def test_cut_of_a_second_loses_nothing_reliable(bed: OutageBed) -> None:
    record = bed.record(FAULTS["cut-1"])
    _assert_once_in_order_and_back(record)
    for flow in FLOWS:
        counts, account = count_topic(record, flow.name, flow.rate), count_account(record, flow.name)
        assert not flow.rate or counts.silence > FAULTS["cut-1"].seconds, "the path was not cut"
        if flow.kind != "best":
            assert account is not None
            assert account.delivered == account.published, (flow, account)
            # More arrives at once after the cut than the default depth, so that a busy listener may lose some.
            assert flow.kind == "reliable" or not counts.lost, (flow, counts)
    calls = count_calls(record)
    assert calls.answered == calls.asked, calls
    assert calls.pending


def test_reset_loses_and_doubles_nothing(bed: OutageBed) -> None:
    record = bed.record(FAULTS["reset"])
    _assert_once_in_order_and_back(record)
    for flow in FLOWS:
        assert flow.kind == "best" or not count_topic(record, flow.name, flow.rate).lost, flow
        account = count_account(record, flow.name)
        assert account is not None
        if flow.kind in {"whole", "deep", "latched"}:
            assert account.delivered == account.heard, (flow, account)


@pytest.mark.long
@pytest.mark.parametrize("side", ["server", "client"])
def test_account_of_what_a_kill_costs_is_whole(bed: OutageBed, side: str) -> None:
    record = bed.record(FAULTS[side])
    for flow in FLOWS:
        account = count_account(record, flow.name)
        assert account is not None
        assert (account.unbalanced, account.accounted) == (0, account.published), (flow, account)


def test_link_moves_between_two_ways(network: Network, tmp_path: Path) -> None:
    """Nothing reliable is lost, no link is lost, and both sides show the way."""
    with OutageBed(tmp_path, "tcp", two_ways=True) as bed:
        client, server = bed.programs["client"], bed.programs["server"]
        eventually(lambda: [way["ready"] for way in client.link().get("ways", ())] == [False, True], what="both ways")
        record = bed.record(FAULTS["way"]._replace(seconds=5.0))
        for program, shown in ((client, ["eth0", "eth1", "eth0"]), (server, ["eth0"])):
            ways = [link["via"] for link in program.links_since(0.0) if link["via"]]
            assert [way for way, _ in groupby(ways)] == shown
            assert not program.happened(EventCode.LINK_LOST)
    _assert_once_in_order_and_back(record)
    for flow in FLOWS:
        counts = count_topic(record, flow.name, flow.rate)
        assert flow.kind == "best" or not counts.lost, (flow, counts)
        assert counts.silence < _MOVED_WITHIN, (flow, counts)


def _assert_once_in_order_and_back(record: Record) -> None:
    assert record.steady
    for flow in FLOWS:
        counts, account = count_topic(record, flow.name, flow.rate), count_account(record, flow.name)
        assert account is not None
        assert (counts.doubled, counts.disordered, account.unbalanced) == (0, 0, 0), (flow, counts, account)
        assert account.accounted == account.published, (flow, account)
        assert flow.kind == "best" or not counts.early, (flow, counts)
        assert counts.back is not None
        assert counts.back < _BACK_WITHIN, (flow, counts)
    latched = [flow.name for flow in FLOWS if flow.kind == "latched"]
    assert all(record.heard[name][-1][0] == len(record.made[name]) for name in latched), "the newest has not come"
    calls = count_calls(record)
    assert (calls.twice, calls.wrong) == (0, 0), calls


# --- the counts themselves


def _record(heard: list[tuple[int, int]]) -> Record:
    """Return a record of 20 messages, one a second from 1 s on, and a fault from 10 to 12 s.

    Args:
        heard: numbers, each with its time of arrival in s.
    """
    made = [number * _S for number in range(1, 21)]
    arrivals = [(number, made[number - 1], at * _S) for number, at in heard]
    events = [(5 * _S, 1, 0), (12 * _S, 1, 1)]
    return Record(10 * _S, 12 * _S, 21 * _S, True, {"/a": made}, {"/a": arrivals}, {"/a": events})


def test_lost_doubled_and_disordered_are_counted() -> None:
    whole = [(number, number) for number in range(1, 21)]
    counts = count_topic(_record(whole), "/a", 1.0)
    assert counts == (12, 0, 0, 0, 0, 1.0, 0.0, 2, 0.0)

    without = [each for each in whole if each[0] not in {3, 11, 12, 13}]
    counts = count_topic(_record(without), "/a", 1.0)
    assert (counts.published, counts.lost, counts.early) == (12, 3, 1)
    assert (counts.silence, counts.back, counts.live) == (4.0, 2.0, 0.0)

    late = [(number, at if at < 11 else max(15, at)) for number, at in whole]
    assert count_topic(_record(late), "/a", 1.0).live == 0.0  # the last one of the burst is live
    stays_late = [(number, at if at < 11 else at + 2 if at < 17 else at + 1) for number, at in whole]
    assert count_topic(_record(stays_late), "/a", 1.0).live is None

    again = [*without, (14, 20), (11, 20), (20, 20)]
    counts = count_topic(_record(again), "/a", 1.0)
    assert (counts.lost, counts.doubled, counts.disordered) == (2, 2, 1)


def test_topic_that_stays_away_is_never_back() -> None:
    counts = count_topic(_record([(number, number) for number in range(1, 11)]), "/a", 1.0)
    assert (counts.lost, counts.silence, counts.back) == (10, 11.0, None)


def test_calls_are_counted_by_their_fates() -> None:
    record = _record([])
    record.calls = [(1 * _S, 0), (9 * _S, 9 * _S), (9 * _S, 13 * _S), (9 * _S, 0), (11 * _S, WRONG)]
    record.offers = [(2 * _S, True), (11 * _S, False), (13 * _S, True)]
    record.carried_out = [1, 2, 3, 3, 5]
    assert count_calls(record) == CallCounts(asked=4, answered=2, pending=2, kept=1, twice=1, wrong=1, events=2)


def test_account_is_compared_with_counts_from_outside() -> None:
    record = _record([(1, 1), (2, 2), (2, 3)])
    assert count_account(record, "/a") is None
    parts = {"offered": 12, "delivered": 3, "unknown": 2, "dropped": {"link lost": 4}}
    record.accounts = {"/a": {**parts, "missed_while_down": 5, "lost_in_dds": 1}}
    dropped = {"link lost": 4, "unknown": 2, "missed_while_down": 5, "lost_in_dds": 1}
    assert count_account(record, "/a") == AccountCounts(20, 18, 2, 3, dropped, 3)
