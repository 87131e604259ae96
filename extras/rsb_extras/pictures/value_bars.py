"""Views that draw values as bars: a battery, and the joints of a robot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rsb_bridge.cdr.decoder import Items
from rsb_bridge.feature_api import Wording
from rsb_extras.pictures.drawing import Canvas, Drawn, UndrawableError, View, first_values, floats, nested, number

if TYPE_CHECKING:
    from rsb_bridge.cdr.decoder import Message
    from rsb_extras.pictures.drawing import TakenMessage
    from rsb_extras.pictures.picture import Wish

_LOW, _EMPTY = 0.3, 0.15
"""Charge of a battery, from which down its bar has the colours of a warning and of an error: round figures."""
_CELLS = 200
"""Cells of a battery whose voltages are looked at: a round figure."""
_MOST_JOINTS = 1000
"""Joints that are drawn: a round figure."""
_SUPPLY = {1: "charging", 2: "discharging", 3: "not charging", 4: "full"}
_HEALTH = {2: "overheated", 3: "dead", 4: "overvoltage", 5: "failed", 6: "cold", 7: "watchdog timer", 8: "safety timer"}
"""Constants of sensor_msgs/msg/BatteryState; of health, those that are faults."""
_QUANTITIES = (("position", ""), ("velocity", "/s"), ("effort", ""))
"""Of sensor_msgs/msg/JointState, with what follows the unit: rad or m, which a message does not say."""
_VALUE = 9
"""Cells of a value, such as -1.23e-05."""
_NAME = 24
"""Most cells of a joint's name."""
_NARROW = 6
"""Cells of a bar; with fewer, values stand alone."""
_EIGHTHS = "▏▎▍▌▋▊▉█"


class BarProblem(Wording):
    """The reason why there are no bars."""

    NO_JOINTS = "the message has no joints"
    NO_MATCH = "no joint contains {joint!r}"


class BatteryView(View):
    """Draws the newest sensor_msgs/msg/BatteryState."""

    def __init__(self) -> None:
        self._message: Message | None = None

    def receive(self, received: TakenMessage) -> None:
        self._message = received.message

    def draw(self, wish: Wish) -> Drawn:
        message = self._message
        if message is None:
            return Drawn()
        charge = number(message, "percentage")
        if charge > 1:  # drivers that give a percentage instead of a part of 1
            charge /= 100
        canvas = Canvas(wish.width, wish.height)
        supply = _SUPPLY.get(_constant(message, "power_supply_status"), "")
        health = _HEALTH.get(_constant(message, "power_supply_health"), "")
        is_known = math.isfinite(charge)
        style = "error" if charge <= _EMPTY else "warning" if charge <= _LOW else "ok"
        title = f"{charge:.0%}" if is_known else "charge unknown"
        canvas.write(1, 0, title, style if is_known else "dim")
        canvas.write(2 + len(title), 0, f"{supply}  ", "strong")
        canvas.write(4 + len(title) + len(supply), 0, health.upper(), "error")
        if is_known:
            across = max(1, wish.width - 2)
            for row in (1, 2):
                canvas.write(1, row, "░" * across, "dim")
                canvas.write(1, row, _bar(charge, across), style)
        facts = [line for line in _facts(message, supply) if line[1]]
        for row, (name, text) in enumerate(facts, 4):
            canvas.write(1, row, f"{name:<12}", "axis")
            canvas.write(14, row, text)
        return Drawn(canvas.cells(), (title, *filter(None, (supply, health))))


def _facts(message: Message, supply: str) -> list[tuple[str, str]]:
    voltage, current, temperature, charge, capacity = (
        number(message, name) for name in ("voltage", "current", "temperature", "charge", "capacity")
    )
    of = f" of {capacity:.4g} Ah" if math.isfinite(capacity) and capacity > 0 else ""
    hours = charge / -current if current < 0 and charge > 0 else math.nan
    power = voltage * current
    cells = [each for each in floats(message, "cell_voltage", _CELLS) if math.isfinite(each)]
    between = f"{min(cells):.3f} to {max(cells):.3f} V, {len(cells)} cells" if cells else ""
    return [
        ("voltage", _shown(voltage, "V")),
        ("current", _shown(current, "A")),
        ("power", _shown(power, "W")),
        ("charge", _shown(charge, "Ah") + of if math.isfinite(charge) else ""),
        ("left", f"{hours:.1f} h at this current" if supply != _SUPPLY[1] and math.isfinite(hours) else ""),
        ("temperature", _shown(temperature, "°C")),
        ("cells", between),
    ]


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}" if math.isfinite(value) else ""


def _constant(message: Message, name: str) -> int:
    value = number(message, name)
    return int(value) if math.isfinite(value) else 0


class JointsView(View):
    """Draws the newest sensor_msgs/msg/JointState, as bars that are full at the largest value seen."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._values: dict[str, list[float]] = {}
        self._largest: dict[str, float] = {}

    def receive(self, received: TakenMessage) -> None:
        message = received.message
        names = nested(message, "name")
        found = first_values(names, _MOST_JOINTS) if isinstance(names, Items) else []
        self._values = {name: floats(message, name, _MOST_JOINTS) for name, _ in _QUANTITIES}
        count = max(len(found), *map(len, self._values.values()))
        self._names = [str(found[at]) if at < len(found) else f"[{at}]" for at in range(count)]
        for name, values in self._values.items():
            sizes = (abs(each) for each in values if math.isfinite(each))
            self._largest[name] = max(self._largest.get(name, 0.0), *sizes, 0.0)

    def draw(self, wish: Wish) -> Drawn:
        if not self._names:
            raise UndrawableError(BarProblem.NO_JOINTS())
        rows = [at for at, name in enumerate(self._names) if wish.match in name]
        if not rows:
            raise UndrawableError(BarProblem.NO_MATCH(joint=wish.match))
        shown = [(name, unit) for name, unit in _QUANTITIES if self._values[name]]
        canvas = Canvas(wish.width, wish.height)
        label = min(_NAME, 1 + max(len(self._names[at]) for at in rows), max(1, wish.width // 3))
        each_has = (wish.width - label) // max(1, len(shown))
        first = max(0, min(len(rows) - 1, int(-wish.y * wish.height)))
        for column, (name, unit) in enumerate(shown):
            canvas.write(label + column * each_has + 1, 0, f"{name}{unit}"[: each_has - 1], "axis")
        for row, at in enumerate(rows[first : first + wish.height - 1], 1):
            canvas.write(0, row, self._names[at][: label - 1], "strong")
            for column, (name, _) in enumerate(shown):
                if at < len(self._values[name]):
                    left = label + column * each_has
                    _write_value(canvas, left, row, each_has, self._values[name][at], self._largest[name])
        return Drawn(canvas.cells(), (f"{len(rows)} joints",))


def _write_value(canvas: Canvas, left: int, row: int, width: int, value: float, largest: float) -> None:
    canvas.write(left, row, f"{value:>{_VALUE}.3g}"[: max(0, width)])
    across = width - _VALUE - 2
    if across < _NARROW or not math.isfinite(value):
        return
    half = across // 2
    middle = left + _VALUE + 1 + half
    canvas.write(middle, row, "│", "axis")
    filled = abs(value) / largest if largest else 0.0
    whole, rest = divmod(round(min(1.0, filled) * half * 2), 2)
    if value > 0:
        canvas.write(middle + 1, row, "█" * whole + "▌" * rest, "path")
    else:
        canvas.write(middle - whole - rest, row, "▐" * rest + "█" * whole, "goal")


def _bar(part: float, across: int) -> str:
    """Return a bar that fills a part of some cells, to an eighth of one."""
    eighths = round(max(0.0, min(1.0, part)) * across * len(_EIGHTHS))
    whole, rest = divmod(eighths, len(_EIGHTHS))
    return "█" * whole + (_EIGHTHS[rest - 1] if rest else "")
