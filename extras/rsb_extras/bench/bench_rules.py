"""Rules on the limits within which a peer may measure a link, and what `check` says of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.config.decoding import join, under
from rsb_bridge.config.topic_rules import range_problems
from rsb_bridge.feature_api import Wording
from rsb_extras.bench import LIMITS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.feature_api import Client, Session

_MOST = 1e6
"""s and MB in an hour; a round figure: an hour has 3,600 s, and so many MB are 278 MB/s."""


class BenchRulesText(Wording):
    OUT_OF_RANGE = "{value} is out of range: above 0, at most {limit}"
    MAY_MEASURE = (
        "{peer} may measure the link (rsb-console bench): {seconds:g} s, {rate:g} messages/s, {megabytes:g} MB in an "
        "hour"
    )


def problems(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the mistakes in the limits, each with its location."""
    holders: list[tuple[str, Session | Client]] = [("bench", session)]
    holders += [(join(join("clients", at), "bench"), each) for at, each in enumerate(session.listed_clients)]
    for location, holder in holders:
        limits = LIMITS.of(holder)
        if limits is None:
            continue
        yield from ((each.location, each.message) for each in under(location, range_problems(limits)))
        for key, value in (("seconds", limits.seconds), ("megabytes", limits.megabytes)):
            if not 0 < value <= _MOST:
                yield join(location, key), BenchRulesText.OUT_OF_RANGE(value=f"{value:g}", limit=f"{_MOST:g}")


def effects(session: Session) -> Iterator[str]:
    """Yield the peers that may measure the link, with their limits."""
    clients = session.accepted_clients if session.role == "server" else ()
    holders = [(client.name, LIMITS.of(client)) for client in clients] or [("the server", LIMITS.of(session))]
    for name, limits in holders:
        if limits is not None:
            values = {"seconds": limits.seconds, "rate": limits.max_rate, "megabytes": limits.megabytes}
            yield BenchRulesText.MAY_MEASURE(peer=name, **values)
