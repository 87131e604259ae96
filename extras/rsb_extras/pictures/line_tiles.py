"""Tiles without a picture: lines that features add."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from textual import work

from rsb_console.feature_console import added_tiles, fit
from rsb_extras.pictures.picture_rows import Part
from rsb_extras.pictures.tile import Tile

if TYPE_CHECKING:
    from textual.worker import Worker

    from rsb_console.feature_console import Console
    from rsb_extras.pictures.layouts import Subject

_REDRAWN_EVERY, _RENEWED_EVERY = 0.5, 1.0  # s; round figures


class LinesTile(Tile):
    """Shows lines that are made from time to time while it is in sight."""

    def __init__(self, console: Console, subject: Subject) -> None:
        super().__init__(console, subject)
        self._source = added_tiles()[subject.topics[0]](console, subject.link)
        self._renewing: Worker[Any] | None = None

    def begin(self) -> None:
        where = f" of {self.where}" if self.where else ""
        self.entitle(f" {self._source.name}{where} ")
        self._clocks = (self.set_interval(_REDRAWN_EVERY, self.fit), self.set_interval(_RENEWED_EVERY, self._renew))
        self._renew()
        self.fit()

    def end(self) -> None:
        for timer in self._clocks:
            timer.stop()

    def _renew(self) -> None:
        """Ask again, unless an answer is still due, perhaps over a thin line."""
        if self._renewing is None or self._renewing.is_finished:
            self._renewing = self._ask()

    @work(group="tile")
    async def _ask(self) -> None:
        await self._source.renew()

    def fit(self) -> None:
        width, height = self.size
        self.show([tuple(Part(*part) for part in fit(line, width)) for line in self._source.lines(height)])
