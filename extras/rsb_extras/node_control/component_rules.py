"""Rules of a component that is loaded, as they are typed: remaps, and parameters of its node."""

from __future__ import annotations

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import parameter_value
from rsb_extras.node_control.parameter_records import NewValue, ParameterValue


class ComponentRule(Wording):
    """Mistakes in a rule."""

    MISSING = "missing"
    RULE = "{rule} is no rule: write {form}"
    WRONG = "{name}: {reason}"


def halves(rule: str, form: str) -> tuple[str, str]:
    """Return the parts of ``from:=to`` or ``name:=value``; raise ValueError, whose text names `form`."""
    name, sign, value = rule.partition(":=")
    if not (name and sign):
        raise ValueError(ComponentRule.RULE(rule=rule, form=form))
    return name, value


def parameter_of(rule: str) -> NewValue:
    """Return the parameter of a rule, ``name:=value``; raise ValueError."""
    name, text = halves(rule, "name:=value")
    try:
        return NewValue(name, ParameterValue.of(*parameter_value(text)))  # type: ignore[arg-type]  # one of the types
    except ValueError as error:
        raise ValueError(ComponentRule.WRONG(name=name, reason=error)) from None
