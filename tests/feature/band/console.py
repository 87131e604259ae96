"""Bands in the shell and in the console."""

from __future__ import annotations

import time
from typing import Any

import msgspec

from rsb_console.feature_console import (
    FAILURE,
    Field,
    FormScreen,
    Spec,
    attached,
    chosen_route,
    print_line,
)

from . import HIGH, LOW, outside
from .bridge import BandCode

_LOOK_EVERY = 0.1  # s; a bridge renews its snapshot four times a second while somebody looks


def watch(arguments: Any) -> int:
    with attached(arguments, read_only=True) as engine:
        seen, was_outside = 0.0, False
        while True:
            moment = engine.snapshot().time
            if moment > seen:
                seen, route = moment, chosen_route(engine, arguments)
                text = outside(route.rate, arguments.low, arguments.high)
                if text and not was_outside:
                    print_line(f"\a{route.topic}: {text}" if not arguments.json else f'{{"outside": "{text}"}}')
                    if arguments.once:
                        return FAILURE
                elif was_outside and not text:
                    print_line(f"{route.topic}: in its band again")
                was_outside = bool(text)
            time.sleep(_LOOK_EVERY)


class BandScreen(FormScreen[tuple[float | None, float | None]]):
    def __init__(self, topic: Any) -> None:
        texts = ["" if key.of(topic) is None else f"{key.of(topic):g}" for key in (LOW, HIGH)]
        fields = [
            Field(Spec(key.name, key.label, key.help, text)) for key, text in zip((LOW, HIGH), texts, strict=True)
        ]
        super().__init__(f"Band of {topic.topic}", fields, "Set")

    def problems(self, values: Any) -> dict[str, str]:
        return {name: "give Hz, or nothing" for name, text in values.items() if text and not _is_number(text)}

    def result(self, values: Any) -> tuple[float | None, float | None]:
        low, high = (float(values[key.name]) if values[key.name] else None for key in (LOW, HIGH))
        return low, high


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


async def set_band(screen: Any) -> None:
    route, console = screen.topics.route, screen.console
    band = None if route is None else await console.ask(BandScreen(route.spec))
    if band is None:
        return
    given = {key.name: value for key, value in zip((LOW, HIGH), band, strict=True) if value is not None}
    others = {name: value for name, value in route.spec.features.items() if name not in (LOW.name, HIGH.name)}
    topic = msgspec.structs.replace(route.spec, features=others | given)
    await console.command(console.engine.edit_topic(route.key, topic), "band set")


class Ringer:
    """Rings when a topic leaves its band."""

    def __init__(self, console: Any) -> None:
        self._console = console

    def hear(self, snapshot: Any, events: Any) -> None:
        if any(event.code == BandCode.LEFT for event in events):
            self._console.bell()
