"""The demands of a running session, which outlive the entries that made them until an operator drops them by name."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final, Protocol

from rsb_bridge.model.demands import Demands, Source, as_armed, describe, kept_whole, sources_of_names

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from rsb_bridge.model.demands import Demand, SourceKey
    from rsb_bridge.model.session import Armed, Kind

MOST_ARMED: Final = 1000
"""Entries of `armed` beyond which a pattern is kept as a whole, instead of the names that it leaves out."""


class Holder(Protocol):
    """A link, which has a part of the session's entries."""

    def demand_sources(self) -> Iterable[Source]:
        """Yield the entries that demand arming, as operators have left them."""
        ...

    def apply_demands(self) -> None:
        """Reopen the routes whose demands have changed."""
        ...

    def demand_dropped(self, source: Source) -> None:
        """Tell the other side that an operator drops a demand."""
        ...


class RunningDemands:
    """Demands from the entries of all links and from the session's `armed`.

    An entry that changes or goes leaves its demand behind, in `armed`, unless an operator has dropped the demand.

    Args:
        armed: returns the running session's `armed`.
        set_armed: replaces it.
        soon: has `apply` called soon.
        kept: is called with a source that is kept in `armed`, and its origin.
        dropped: is called with a source that an operator has dropped, and its origin.
    """

    def __init__(
        self,
        armed: Callable[[], tuple[str | Armed, ...]],
        set_armed: Callable[[tuple[str | Armed, ...]], None],
        soon: Callable[[], object],
        kept: Callable[[Source, str], None],
        dropped: Callable[[Source, str], None],
    ) -> None:
        self._armed = armed
        self._set_armed = set_armed
        self._soon = soon
        self._kept = kept
        self._dropped = dropped
        self._holders: list[Holder] = []
        self._settled = Demands()
        self._given: tuple[str | Armed, ...] = ()
        self._is_stale = True
        self._is_due = self._differs = False
        self._depth = 0
        self._permitted: set[Source] = set()
        self._places: Mapping[SourceKey, str] = {}
        self._changed_by: dict[SourceKey, str] = {}

    # --- the entries

    def register(self, holder: Holder) -> None:
        """Count the entries of one more link."""
        self._holders.append(holder)
        self.changed()

    def unregister(self, holder: Holder) -> None:
        """Forget a link; its demands stay."""
        if holder in self._holders:
            self._holders.remove(holder)
            self.changed()

    def changed(self) -> None:
        """Note that an entry was added, changed or removed."""
        self._is_stale = True
        if not self._is_due:
            self._is_due = True
            self._soon()

    def of(
        self, kind: Kind, name: str, type_name: str = "", *, client: str = "", client_name: str = ""
    ) -> Demand | None:
        """Return the present demand on a name; `Demands.of` has the same arguments."""
        if self._depth and (self._is_stale or self._given != self._armed()):  # unfinished: drops nothing yet
            demands = Demands((*self._settled.sources, *self._present()))
        else:
            self._settle()
            demands = self._settled
        return demands.of(kind, name, type_name, client=client, client_name=client_name)

    @property
    def sources(self) -> tuple[Source, ...]:
        """The lines that demand arming now."""
        self._settle()
        return self._settled.sources

    def keep(self, source: Source, who: str) -> None:
        """Demand what an entry demands that cannot be added; `who` wants it."""
        self._keep([source], who)
        self.changed()

    # --- changes by operators

    @contextlib.contextmanager
    def changing(self, who: str) -> Iterator[None]:
        """Change entries: demands that are gone at the end, and not permitted to go, are kept.

        Args:
            who: makes the change, in words.
        """
        self._settle()
        known, armed = {source.key for source in self._settled.sources}, self._armed()
        self._depth += 1
        try:
            yield
        except BaseException:
            self._permitted.clear()
            self._set_armed(tuple(dict.fromkeys((*self._armed(), *armed))))
            raise
        finally:
            self._depth -= 1
            if not self._depth:
                self._settle(who)
                known |= self._places.keys() | self._changed_by.keys()
                new = (each.key for each in self._settled.sources if each.key not in known)
                self._changed_by |= dict.fromkeys(new, who)
                self.apply()

    def permit(self, sources: Collection[Source]) -> None:
        """Let demands go in the present change, as an operator has agreed to by name.

        The other side is told now, before the change closes the routes; so nothing may refuse the change after this.
        """
        self._permitted.update(sources)
        gone = {as_armed(each) for each in sources}
        self._set_armed(tuple(each for each in self._armed() if each not in gone))
        for source in sources:
            for holder in self._holders:
                holder.demand_dropped(source)
        self.changed()

    def apply(self) -> None:
        """Reopen the routes whose demands have changed."""
        if self._depth or not self._is_due:
            return
        self._settle()
        differs, self._is_due, self._differs = self._differs, False, False
        for holder in tuple(self._holders) if differs else ():
            holder.apply_demands()

    def _present(self) -> Iterator[Source]:
        yield from sources_of_names(self._armed())
        for holder in self._holders:
            yield from holder.demand_sources()

    def _settle(self, who: str = "") -> None:
        """Take in what has changed, and keep what would be lost by that."""
        if self._depth or not (self._is_stale or self._given != self._armed()):
            return
        self._is_stale = False
        permitted, self._permitted = self._permitted, set()
        present = tuple(dict.fromkeys(self._present()))
        if present == self._settled.sources:  # as after most changes, of which peers can cause many
            self._given = self._armed()
            return
        now, armed = Demands(present), self._armed()
        for source, rest in now.missing(self._settled.sources).items():
            origin = self.origin(source)
            if source in permitted:
                self._dropped(source, origin)
            else:
                is_full = len(self._armed()) + len(rest) > MOST_ARMED
                self._keep((kept_whole(source),) if is_full else rest, who)
                self._kept(source, origin)
        self._given = self._armed()
        before, self._settled = self._settled, now if self._given == armed else Demands(self._present())
        self._differs |= before.sources != self._settled.sources

    def _keep(self, sources: Iterable[Source], who: str) -> None:
        armed = self._armed()
        for source in sources:
            if (entry := as_armed(source)) not in armed:
                armed = (*armed, entry)
                (new,) = sources_of_names([entry])
                self._changed_by[new.key] = who or "the other side"
        self._set_armed(armed)

    # --- where the lines are

    def set_places(self, places: Mapping[SourceKey, str]) -> None:
        """Take the lines of a session file, by their entries."""
        self._places = places
        self._changed_by = {key: who for key, who in self._changed_by.items() if key not in places}
        self._differs = True
        self.changed()

    def origin(self, source: Source) -> str:
        """Return the line that demands arming, for an operator."""
        if (who := self._changed_by.get(source.key)) is not None:
            by = f"added by {who}" if isinstance(source.key[1], tuple) else f"kept since a change by {who}"
            return describe(source, {source.key: by})
        return describe(source, self._places)
