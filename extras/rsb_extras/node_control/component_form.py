"""The form of a component that a container is to load."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_console.feature_console import Field, FormScreen, Spec
from rsb_extras.node_control.change_records import Component
from rsb_extras.node_control.component_rules import ComponentRule, halves, parameter_of
from rsb_extras.node_control.parameter_records import NewValues

if TYPE_CHECKING:
    from collections.abc import Mapping

_INTRA_PROCESS = (("no", "no"), ("yes", "yes"))


class ComponentForm(FormScreen[tuple[Component, NewValues]]):
    """A component, with the parameters of its node."""

    def __init__(self, container: str) -> None:
        many = "Write ; between several."
        fields = [
            Field(Spec("package", "Package", "The package that has it: nav2_planner.")),
            Field(Spec("plugin", "Plugin", "Its class: nav2_planner::PlannerServer.")),
            Field(Spec("name", "Name", "The name of its node.", blank="empty: its own")),
            Field(Spec("namespace", "Namespace", "The namespace of its node.", blank="empty: its own")),
            Field(Spec("parameters", "Parameters", f"name:=value, in YAML. {many}", blank="none")),
            Field(Spec("remaps", "Remaps", f"from:=to, of topics and services. {many}", blank="none")),
            Field(Spec("intra", "Direct", "Whether it hands messages to others of the container directly.", "no",
                       options=_INTRA_PROCESS)),
        ]  # fmt: skip
        super().__init__(f"Load into {container}", fields, "Load…")

    def problems(self, values: Mapping[str, str]) -> dict[str, str]:
        found = {key: ComponentRule.MISSING() for key in ("package", "plugin") if not values[key]}
        for key, check in (("parameters", parameter_of), ("remaps", lambda rule: halves(rule, "from:=to"))):
            try:
                for rule in _rules(values[key]):
                    check(rule)
            except ValueError as error:
                found[key] = str(error)
        return found

    def result(self, values: Mapping[str, str]) -> tuple[Component, NewValues]:
        component = Component(
            values["package"], values["plugin"], values["name"], values["namespace"],
            tuple(_rules(values["remaps"])), values["intra"] == "yes",
        )  # fmt: skip
        return component, tuple(map(parameter_of, _rules(values["parameters"])))


def _rules(text: str) -> list[str]:
    return [rule.strip() for rule in text.split(";") if rule.strip()]
