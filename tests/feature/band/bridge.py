"""The rates of one link's topics against their bands."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from rsb_bridge.feature_api import EnginePart, Extension, Level, State, Verdict

from . import AFTER, HIGH, LOW, outside


class BandCode(StrEnum):
    LEFT = "band.left"
    BACK = "band.back"


class Bands(Extension):
    """Which routes of one link are outside of their bands, by their keys."""

    def __init__(self, link: Any) -> None:
        self._link = link
        self._since: dict[str, float] = {}
        self._verdicts: dict[str, Verdict] = {}

    def tick(self) -> None:
        for key in self._since.keys() - self._link.routes.keys():
            del self._since[key]
            self._verdicts.pop(key, None)
        for route in self._link.routes.values():
            self._look(route)

    def verdict(self, route: Any) -> Verdict | None:
        return self._verdicts.get(route.key)

    def _look(self, route: Any) -> None:
        band = LOW.of(route.spec), HIGH.of(route.spec)
        text = outside(route.meter.rate, *band) if route.connected else ""
        was_left = route.key in self._verdicts
        if not text:
            self._since.pop(route.key, None)
            self._verdicts.pop(route.key, None)
            if was_left:
                route.log(Level.INFO, BandCode.BACK, "its rate is in its band again")
                route.judge_again()
            return
        now = self._link.context.now()
        since = self._since.setdefault(route.key, now)
        if now - since < AFTER.of(self._link.context.session):
            return
        self._verdicts[route.key] = Verdict(State.SLOW, "band.left", f"{text}: see what publishes it", since)
        route.judge_again()
        if not was_left:
            route.log(Level.WARNING, BandCode.LEFT, text)


class BandPart(EnginePart):
    def __init__(self) -> None:
        super().__init__()
        self.by_key = (((AFTER.name,), lambda: None),)  # it is read whenever it is needed
