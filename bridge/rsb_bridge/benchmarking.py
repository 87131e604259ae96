"""What benchmarks order of one bridge."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.link.errors import LinkError
from rsb_bridge.model.benchmark import Outcome, Usage
from rsb_bridge.ros.synthetic import resources

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.link.link import Link
    from rsb_bridge.model.benchmark import Order


async def carry_out(order: Order, links: Sequence[Link]) -> Outcome:
    """Do what a benchmark orders.

    Raises:
        LinkError: it cannot be done, or the peer does not allow it.
    """
    if order.what == "measure":
        cpu, memory = resources()
        sent, received = (sum(each) for each in zip((0, 0), *(link.bench.wire_bytes() for link in links), strict=True))
        return Outcome(Usage(cpu, memory, sent, received))
    link = _chosen(order.link, links)
    if order.what == "run":
        return await link.bench.run(order)
    link.bench.end()
    return Outcome(link.bench.usage())


def _chosen(name: str, links: Sequence[Link]) -> Link:
    found = [link for link in links if name in ("", link.name)]
    if len(found) != 1:
        raise LinkError(f"say which client: one of {', '.join(link.name for link in links)}")
    return found[0]
