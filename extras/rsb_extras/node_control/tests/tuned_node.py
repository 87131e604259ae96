"""A real node with parameters of all types, of rclpy, in a robot's domain."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter
from tests.support.spun import Spun

if TYPE_CHECKING:
    from rclpy.node import Node

VALUES: dict[str, Any] = {
    "frame": "map", "flags": [True, False], "gains": [1.5, -2.0], "ids": [2**63 - 1, -(2**63)], "names": ["a", "b c"],
    "raw": [b"\x00", b"\xff"], "planner.tolerance": 0.25, "planner.plugin.name": "grid", "enabled": True,
}  # fmt: skip
LARGE = "<robot>\n" + "x" * 100_000


class TunedNode:
    """The node.

    Attributes:
        refused: the reason with which it refuses any change, or empty.
    """

    def __init__(self, domain_id: int, name: str = "controller") -> None:
        self.refused = ""
        self._spun = Spun(domain_id, name)
        node = self.node
        for parameter, value in VALUES.items():
            node.declare_parameter(parameter, value)
        for parameter, value, descriptor in (
            (
                "max_speed", 0.5,
                ParameterDescriptor(
                    description="m/s, in the plane", additional_constraints="below the robot's own",
                    floating_point_range=[FloatingPointRange(from_value=0.0, to_value=2.0, step=0.1)],
                ),
            ),
            ("count", 4, ParameterDescriptor(integer_range=[IntegerRange(from_value=0, to_value=10, step=2)])),
            ("serial", "A-17", ParameterDescriptor(read_only=True)),
            ("any", 1, ParameterDescriptor(dynamic_typing=True)),
            ("description", LARGE, ParameterDescriptor()),
        ):  # fmt: skip
            node.declare_parameter(parameter, value, descriptor)
        node.declare_parameter("unset", Parameter.Type.DOUBLE)
        node.add_on_set_parameters_callback(self._set)

    @property
    def node(self) -> Node:
        return self._spun.node

    def _set(self, parameters: list[Parameter]) -> SetParametersResult:
        return SetParametersResult(successful=not self.refused, reason=self.refused)

    def __getitem__(self, name: str) -> Any:
        return self.node.get_parameter(name).value

    def close(self) -> None:
        self._spun.close()
