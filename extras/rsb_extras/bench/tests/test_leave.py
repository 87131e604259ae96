"""Limits of a peer's measurements of the link, by session."""

from __future__ import annotations

from rsb_bridge.config.rights import Use, rights_of_client, rights_of_server
from rsb_bridge.config.session_changes import with_client
from rsb_bridge.config.validation import build, validate
from rsb_bridge.model.session import Client, Session
from rsb_extras.bench import LIMITS, BenchmarkLimits
from rsb_extras.bench.link_bench import HOUR, BenchBudget
from rsb_extras.bench.tests.peer_s_share_helpers import Here

SERVER = {"name": "pc", "role": "server", "server_ip": "127.0.0.1", "server_port": 7060, "key_file": "k"}
BENCHES = Here().bench


def test_nobody_may_measure_without_leave() -> None:
    for client in (Client("robot1"), Client("robot1", allow=("*", "bench/*"))):
        for sends in (True, False):
            refusal = BENCHES.denial(rights_of_client(client, "pc"), sends=sends)
            assert "add bench: {}" in str(refusal)


def test_with_leave_peer_measures_whatever_else_is_denied() -> None:
    client = Client("robot1", allow=("/scan",), deny=("*",), features={LIMITS.name: BenchmarkLimits(max_rate=50.0)})
    rights = rights_of_client(client, "pc")
    for sends in (True, False):
        assert BENCHES.denial(rights, sends=sends) is None
    assert rights.refusal(Use("/odom", "publish", "tcp")) is not None, "leave to measure is no leave for anything else"
    assert rights.refusal(Use("/bench/tcp/transmit", "publish", "tcp")) is not None


def test_client_s_session_gives_leave_to_server() -> None:
    session = Session(name="robot1", role="client", server_ip="10.0.0.1", server_port=7060, key_file="k")
    assert BENCHES.denial(rights_of_server(session), sends=True) is not None
    features = {LIMITS.name: BenchmarkLimits()}
    given = Session(name="robot1", role="client", server_ip="10.0.0.1", server_port=7060, features=features)
    assert BENCHES.denial(rights_of_server(given), sends=True) is None


def test_leave_is_read_from_file_and_checked() -> None:
    session, problems = build({**SERVER, "clients": [{"name": "robot1", "key_file": "k", "bench": {"seconds": 10}}]})
    assert not problems
    assert LIMITS.of(session.listed_clients[0]) == BenchmarkLimits(seconds=10)
    assert validate(session) == []
    for wrong in ({"seconds": 0}, {"megabytes": -1}, {"max_rate": 0}, {"bytes": 5}, "yes"):
        _, problems = build({**SERVER, "bench": wrong})
        assert problems, wrong


def test_servers_leave_is_for_its_only_client() -> None:
    session, problems = build({**SERVER, "bench": {}})
    assert not problems
    assert LIMITS.of(session.accepted_clients[0]) == BenchmarkLimits()
    both = with_client(session, Client("robot2", key_file="l"))
    assert [LIMITS.of(client) for client in both.listed_clients] == [BenchmarkLimits(), None]
    assert validate(both) == []
    assert build({**SERVER, "bench": {}, "clients": [{"name": "robot1", "key_file": "k"}]})[1]


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0


def test_budget_limits_time_rate_bytes_each_hour() -> None:
    clock, leave = Clock(), BenchmarkLimits(seconds=10.0, max_rate=100.0, megabytes=1.0)
    budget = BenchBudget(lambda: clock.now)
    assert budget.refusal(None)
    assert not budget.refusal(leave)
    assert budget.refusal(leave, rate=101.0)
    assert budget.refusal(leave, seconds=10.5)
    assert budget.refusal(leave, size=1.1e6)
    budget.spend(4.0, 0.5e6)
    assert not budget.refusal(leave, seconds=6.0, size=0.5e6, rate=100.0)
    assert budget.refusal(leave, seconds=6.1)
    assert budget.refusal(leave, size=0.6e6)
    budget.spend(1.0, 0.5e6)
    assert budget.refusal(leave), "the bytes are used up"
    clock.now += HOUR
    assert not budget.refusal(leave, seconds=10.0, size=1e6)


def test_the_hour_begins_with_the_first_use() -> None:
    clock, leave = Clock(), BenchmarkLimits(seconds=10.0)
    budget = BenchBudget(lambda: clock.now)
    clock.now += 0.9 * HOUR
    budget.spend(10.0, 0.0)
    clock.now += 0.2 * HOUR
    assert budget.refusal(leave)
    clock.now += 0.8 * HOUR
    assert not budget.refusal(leave)
