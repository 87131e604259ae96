"""Exporters: a bridge in ROS diagnostics, to Prometheus, and to a command that is run on faults."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from rsb_bridge.feature_api import Feature, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from rsb_bridge.feature_api import Bridge, EnginePart

DIAGNOSTICS_TOPIC: SessionKey[str | None] = SessionKey(
    "diagnostics_topic", str | None, "/diagnostics", live=True, own_topic=True, shared_topic=True
)
"""The topic of the state of links and routes, as ``diagnostic_msgs/DiagnosticArray``; or None."""
DRIVER_TOPIC: SessionKey[str | None] = SessionKey("driver_topic", str | None, None, live=True, own_topic=True)
"""The topic of who holds which armed topic, as ``std_msgs/String`` with a JSON list; or None."""
METRICS: SessionKey[str | None] = SessionKey("metrics", str | None, None, live=True)
"""The address on which Prometheus finds the metrics, ``127.0.0.1:9464``; or None."""
ON_FAULT: SessionKey[str | tuple[str, ...] | None] = SessionKey(
    "on_fault", str | tuple[str, ...] | None, None, live=True, hidden_as="command"
)
"""The command to run when a fault begins, changes or is over, or None: a list of words, or a text that
`fault_command.command_words` splits as a shell would."""


class Exporters(Feature):
    name = "exporters"
    libraries: ClassVar[Mapping[str, str]] = {"metrics": "prometheus_client"}

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return DIAGNOSTICS_TOPIC, DRIVER_TOPIC, METRICS, ON_FAULT

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        from rsb_extras.exporters import rules  # noqa: PLC0415 -- `Feature` says why, here and below

        return rules.problems(session)

    def advice(self, session: Any, file: Path | None) -> Iterable[tuple[str, str]]:
        from rsb_extras.exporters import rules  # noqa: PLC0415

        return rules.advice(session, file)

    def effects(self, session: Any) -> Iterable[str]:
        from rsb_extras.exporters import rules  # noqa: PLC0415

        return rules.effects(session)

    def refusal(self, session: Any, topic: str) -> str:
        if topic != DRIVER_TOPIC.of(session):
            return ""
        from rsb_extras.exporters.ros_topics import DriverTopicText  # noqa: PLC0415

        return DriverTopicText.REFUSED(topic=topic)

    def parts(self, bridge: Bridge) -> Iterable[EnginePart]:
        from rsb_extras.exporters.fault_hook import FaultHook  # noqa: PLC0415
        from rsb_extras.exporters.metrics_exporter import MetricsExporter  # noqa: PLC0415
        from rsb_extras.exporters.ros_topics import DiagnosticsExporter, DriverExporter  # noqa: PLC0415

        return (
            DiagnosticsExporter(bridge.context, bridge.newest_snapshot),
            DriverExporter(bridge.context, bridge.newest_snapshot),
            MetricsExporter(bridge.context, bridge.newest_snapshot),
            FaultHook(bridge.context, bridge.folder),
        )


FEATURE = Exporters()
