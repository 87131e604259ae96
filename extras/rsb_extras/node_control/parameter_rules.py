"""New values of a node's parameters: what they mean there, why one cannot be set, and what differs from a file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from rsb_bridge.feature_api import Wording, sanitize_text
from rsb_console.feature_console import shown_value
from rsb_extras.node_control.parameter_records import NewValue, ParameterValue

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from rsb_console.feature_console import WrittenValue
    from rsb_extras.node_control.parameter_records import NodeParameter, ParameterRange

_CLOSE = 1e-6
"""Steps that a double may be beside one: nodes are as generous, and say no if they are not."""


class ParameterText(Wording):
    """Parameters and their changes in words."""

    CHANGE = "{name}: {old} → {new}"
    LEFT_OUT = "{name} is left out: {reason}"
    NOT_SET = "not set"
    NOT_READ = "({type}, {size:,} bytes)"
    UNREADABLE = "(unreadable)"
    BOUNDS = "{low} to {high}"
    STEPS = "{low} to {high} in steps of {step}"
    NO_PARAMETER = "the node has no such parameter"
    TOO_LARGE = "its value there is larger than a link carries"
    READ_ONLY = "it is read-only"
    OUTSIDE = "{value} is not in its range, {bounds}"
    NO_STEP = "{value} is no step of its range, {bounds}"
    NO_TEXT = "it is no text in UTF-8"


class ParameterChange(NamedTuple):
    """A parameter's new value, that differs from the one it has.

    Attributes:
        old, new: as plain data.
    """

    parameter: NodeParameter
    type: str
    new: Any

    @property
    def name(self) -> str:
        return self.parameter.name

    @property
    def old(self) -> Any:
        return plain_value(self.parameter)

    def __str__(self) -> str:
        return ParameterText.CHANGE(name=self.name, old=value_text(self.parameter), new=shown_value(self.new))

    @property
    def value(self) -> NewValue:
        plain = bytes(self.new) if self.type == "byte_array" else self.new
        seen = "" if self.parameter.size else self.parameter.value.digest
        return NewValue(self.name, ParameterValue.of(self.type, plain), seen)  # type: ignore[arg-type]  # one of these


class Comparison(NamedTuple):
    """New values beside a node's.

    Attributes:
        changes: those that differ and can be set.
        left_out: the reasons why others are left out, by their names.
        wrong: the reasons why others cannot be set, by their names.
        equal: how many are the same.
    """

    changes: Sequence[ParameterChange]
    left_out: Mapping[str, str]
    wrong: Mapping[str, str]
    equal: int


def plain_value(parameter: NodeParameter) -> Any:
    """Return a value as plain data, or None if there is none, or none that can be read."""
    try:
        return parameter.value.plain()
    except ValueError:
        return None


def value_text(parameter: NodeParameter) -> str:
    """Return a value in a line, cut if it is long."""
    if parameter.size:
        return ParameterText.NOT_READ(type=parameter.value.type, size=parameter.size)
    try:
        plain = parameter.value.plain()
    except ValueError:
        return ParameterText.UNREADABLE()
    return ParameterText.NOT_SET() if plain is None else shown_value(plain)


def bounds_text(bounds: ParameterRange) -> str:
    text = ParameterText.STEPS if bounds.step else ParameterText.BOUNDS
    return text(low=f"{bounds.low:g}" if isinstance(bounds.low, float) else bounds.low,
                high=f"{bounds.high:g}" if isinstance(bounds.high, float) else bounds.high,
                step=f"{bounds.step:g}" if isinstance(bounds.step, float) else bounds.step)  # fmt: skip


def about(parameter: NodeParameter) -> str:
    """Return what a parameter's descriptor says, in a line."""
    parts = [
        "read-only" if parameter.read_only else "",
        "any type" if parameter.dynamic else "",
        *map(bounds_text, parameter.ranges),
        parameter.description,
        parameter.constraints,
    ]
    return "; ".join(filter(None, parts))


def change_of(parameter: NodeParameter, meant: Callable[[str], tuple[str, Any]]) -> ParameterChange:
    """Return the change to a new value, which may be the old one.

    Args:
        meant: returns the type and the value as plain data, for the type that it must have, or for an empty one.

    Raises:
        ValueError: the parameter cannot have it; the text says why.
    """
    is_free = parameter.dynamic or parameter.value.type == "not_set"
    kind, plain = meant("" if is_free else parameter.value.type)
    change = ParameterChange(parameter, kind, plain)
    try:
        change.value.value.plain()
    except UnicodeError:
        raise ValueError(ParameterText.NO_TEXT()) from None
    if parameter.ranges and kind in ("integer", "double"):
        _check_range(plain, parameter.ranges[0])
    return change


def _check_range(value: float, bounds: ParameterRange) -> None:
    low, high, step = bounds.low, bounds.high, bounds.step
    shown = {"value": shown_value(value), "bounds": bounds_text(bounds)}
    if not low <= value <= high:
        raise ValueError(ParameterText.OUTSIDE(**shown))
    if not step or value in (low, high):
        return
    exact = all(isinstance(each, int) for each in (value, low, step))
    beside = (value - low) % step if exact else abs((value - low) / step - round((value - low) / step))
    if beside > (0 if exact else _CLOSE):
        raise ValueError(ParameterText.NO_STEP(**shown))


def compare(parameters: Iterable[NodeParameter], written: Mapping[str, WrittenValue]) -> Comparison:
    """Compare a node's parameters with values of a file."""
    known = {each.name: each for each in parameters}
    changes, left_out, wrong, equal = list[ParameterChange](), dict[str, str](), dict[str, str](), 0
    for name, value in written.items():
        parameter = known.get(name)
        if parameter is None:
            left_out[name] = ParameterText.NO_PARAMETER()
            continue
        if parameter.size:
            left_out[name] = ParameterText.TOO_LARGE()
            continue
        try:
            change = change_of(parameter, value.meant)
        except ValueError as error:
            wrong[name] = sanitize_text(str(error))
            continue
        if parameter.value.content == change.value.value.content and parameter.value.type == change.type:
            equal += 1
        elif parameter.read_only:
            left_out[name] = ParameterText.READ_ONLY()
        else:
            changes.append(change)
    return Comparison(changes, left_out, wrong, equal)
