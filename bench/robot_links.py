"""The links of `bench.robot`, with the topics and calls of the robots on them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from bench.robot_ends import GOAL, NODE, PARAMETERS, RESULT

if TYPE_CHECKING:
    from collections.abc import Sequence


class Spoken(NamedTuple):
    """A topic of the robot.

    Attributes:
        transport: that it always uses, or an empty string for the column's.
        robot: whose bridge sends it. All robots are at one end of the link.
        to_robot: whether the PC publishes it, for the robot.
    """

    name: str
    rate: float
    size: int
    priority: str = "normal"
    reliability: str = "reliable"
    transport: str = ""
    robot: str = "robot"
    to_robot: bool = False

    @property
    def row(self) -> str:
        """The figures' name: topics that differ in their number only are one."""
        return self.name.rstrip("0123456789")

    @property
    def is_large(self) -> bool:
        """Whether it has a process of its own, since publishing it takes milliseconds."""
        return self.size > 50_000

    def __str__(self) -> str:
        return f"{self.name}:{self.rate}:{self.size}:{self.reliability}"


class Called(NamedTuple):
    """Something of the robot that the PC calls.

    Attributes:
        size: bytes of an answer of a service.
        kind: ``service``, ``action``, or ``parameters`` of the node.
    """

    name: str
    rate: float
    size: int
    kind: str = "service"

    @property
    def rows(self) -> Sequence[str]:
        """The measured topics or calls."""
        return (GOAL + self.name, RESULT + self.name) if self.kind == "action" else (self.name,)

    @property
    def entry(self) -> str:
        """Its entry in a session."""
        return f"node: /{NODE}" if self.kind == "parameters" else f"{self.kind}: {self.name}"

    def __str__(self) -> str:
        return f"{self.name}:{self.rate}:{self.size}:{self.kind}"


class Link(NamedTuple):
    """A link, with the arguments of `wifi.c`, and the topics and calls on it."""

    figures: str
    topics: tuple[Spoken, ...]
    calls: tuple[Called, ...] = ()

    @property
    def robots(self) -> Sequence[str]:
        """The owners of the bridges that it carries."""
        return list(dict.fromkeys(each.robot for each in self.topics))

    @property
    def rows(self) -> dict[str, str]:
        """The figures in words, by their names."""
        topics = {each.row: f"{each.row} {each.rate:g} Hz × {each.size:,}" for each in self.topics}
        return topics | {row: f"{row} {each.rate:g} Hz × {each.size:,}" for each in self.calls for row in each.rows}


LINKS = {
    "wifi": Link(
        "20 15 2 20000000 400000 30 3",
        (
            Spoken("/odom", 50, 730, "high"),
            Spoken("/tf", 50, 400, "high"),
            Spoken("/joint_states", 100, 470),
            Spoken("/imu", 100, 330, reliability="best_effort"),
            Spoken("/scan", 10, 4000, reliability="best_effort"),
            Spoken("/pose", 5, 360),
            Spoken("/path", 1, 20_000),
            Spoken("/local_costmap", 2, 3_700),
            Spoken("/costmap", 1, 40_000),
            Spoken("/battery", 0.5, 200),
            Spoken("/health", 1, 4_000),
            Spoken("/camera", 30, 60_000, "low", "best_effort"),
            Spoken("/raw", 10, 6_220_800, "low", "best_effort"),
        ),
        (
            Called("/status", 2, 60),
            Called("/plan", 0.5, 20_000),
            Called("/clear", 0.2, 0),
            Called("/navigate", 0.2, 0, "action"),
            Called(PARAMETERS, 0.5, 0, "parameters"),
        ),
    ),
    "tunnel": Link(
        "5 0 0 40000 4400000 0 0",
        (
            Spoken("/high", 10, 100, "high"),
            Spoken("/normal", 10, 500),
            Spoken("/low", 10, 500, "low", "best_effort"),
        ),
    ),
    "mixed": Link(
        "5 0 0 40000 10000 0 0",
        (
            Spoken("/odom", 20, 700, transport="tcp"),
            Spoken("/scan", 15, 1_000, reliability="best_effort", transport="udp"),
            Spoken("/joy", 10, 50, transport="tcp"),
        ),
    ),
    "high-udp": Link(
        "5 0 0 40000 10000 0 0",
        (
            Spoken("/odom", 20, 700, transport="tcp"),
            Spoken("/scan", 15, 1_000, "high", "best_effort", transport="udp"),
        ),
    ),
    "whole": Link("5 0 0 40000 10000 0 0", (Spoken("/cloud", 1, 20_000, "normal", "best_effort", transport="udp"),)),
    "lossy": Link(
        "20 0 30 20000000 400000 0 0",
        (
            Spoken("/scan", 50, 1_000, reliability="best_effort", transport="udp"),
            Spoken("/slow", 2, 200, reliability="best_effort", transport="udp"),
            Spoken("/odom", 10, 100, transport="tcp"),
        ),
    ),
    "alone": Link("20 0 2 20000000 400000 0 0", (Spoken("/joint_states", 100, 470),)),
    "beside": Link(
        "20 0 2 20000000 400000 0 0",
        (Spoken("/joint_states", 100, 470), Spoken("/camera", 20, 60_000, reliability="best_effort")),
    ),
    "two-robots": Link(
        "20 15 2 20000000 400000 0 0",
        tuple(
            Spoken(f"{name}{topic}", rate, size, priority, reliability, robot=robot)
            for robot, name in (("robot", ""), ("second", "/second"))
            for topic, rate, size, priority, reliability in (
                ("/odom", 50, 730, "high", "reliable"),
                ("/joint_states", 100, 470, "normal", "reliable"),
                ("/camera", 30, 60_000, "low", "best_effort"),
            )
        ),
    ),
    "both-ways": Link(
        "20 15 2 20000000 400000 0 0",
        (
            Spoken("/odom", 50, 730, "high"),
            Spoken("/joint_states", 100, 470),
            Spoken("/cmd_vel", 20, 60, "high", to_robot=True),
            Spoken("/map", 40, 60_000, "low", "best_effort", to_robot=True),
        ),
    ),
    "many": Link("20 0 0 20000000 400000 0 0", tuple(Spoken(f"/topic{number}", 1, 300) for number in range(500))),
}

_WIFI = LINKS["wifi"]
# An operator who wants whole images sooner than pictures of the camera.
LINKS["raw-first"] = _WIFI._replace(
    topics=tuple(each._replace(priority="high") if each.name == "/raw" else each for each in _WIFI.topics)
)
