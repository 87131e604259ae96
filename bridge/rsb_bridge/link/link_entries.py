"""The entries of a session that one side of a link proposes: topics, services and patterns."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.demands import sources_of_entries

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.link_patterns import LinkPatterns
    from rsb_bridge.link.proposed_routes import ProposedTopics
    from rsb_bridge.link.route_table import RouteTable
    from rsb_bridge.model.demands import DemandSource
    from rsb_bridge.model.session import Topic


class LinkEntries:
    """The entries of one link, and what they demand (`rsb_bridge.model.demands.Holder`)."""

    def __init__(self, link: BaseLink, table: RouteTable, proposed: ProposedTopics, patterns: LinkPatterns) -> None:
        self._link, self._table, self._proposed, self._patterns = link, table, proposed, patterns

    def all(self) -> tuple[Topic, ...]:
        """Return the topics and patterns that this side proposes. May be called from any thread."""
        return (*self._proposed.all(), *self._patterns.all())

    def add(self, topic: Topic) -> str:
        """Bridge one more topic, or follow one more pattern; return its key.

        Raises:
            LinkError: the entry has a mistake, or exists already.
        """
        return self._patterns.add(topic) if topic.is_pattern else self._proposed.add(topic).key

    def demand_sources(self) -> Iterable[DemandSource]:
        """Yield the entries that demand arming, as operators have left them."""
        link, on_server = self._link, not self._link.is_client
        return sources_of_entries(self.all(), link.name, on_server=on_server, use_name=on_server and link.end.use_name)

    def apply_demands(self) -> None:
        self._table.apply_demands()

    def demand_dropped(self, source: DemandSource) -> None:
        """Tell the other side that an operator drops a demand."""
        self._table.arming.demand_dropped(source)
