"""Publishes how the links and routes are on ``/diagnostics``, for the instruments that ROS users have."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.calls import FieldError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.snapshot import Level
from rsb_bridge.ros.announcements import Origin
from rsb_bridge.ros.ros_interface import Endpoint, RosError
from rsb_bridge.telemetry.diagnostics import diagnostics

if TYPE_CHECKING:
    from rsb_bridge.context import Context
    from rsb_bridge.model.snapshot import Snapshot
    from rsb_bridge.ros.ros_interface import Publisher

_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
_QOS = Qos()  # as diagnostic_updater


class Diagnostics:
    """The bridge's publisher on the session's `diagnostics_topic`. It belongs to the I/O thread."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._publisher: Publisher | None = None

    def open(self) -> None:
        """Publish from now on, on the topic that the session names now. What does not work ends nothing else."""
        self.close()
        topic = self._context.session.diagnostics_topic
        if topic is None:
            return
        ros = self._context.ros
        type_hash = ros.installed_hash(_TYPE)
        if type_hash is None:
            self._failed(f"{_TYPE} is not installed here", Level.INFO)
            return
        try:
            self._publisher = ros.advertise(topic, _TYPE, type_hash, _QOS, self)
            endpoint = Endpoint(f"/{ros.node_name}", _TYPE, type_hash, _QOS, self._publisher.gid)
            self._context.announcements.announce(topic, self, endpoint, Origin(()))
        except RosError as error:
            self._failed(str(error))

    def tick(self, snapshot: Snapshot) -> None:
        """Publish how everything is, if anybody listens; to be called once a second."""
        if self._publisher is None or not (self._publisher.subscriber_count or self._bridged(snapshot)):
            return
        try:
            ros, now = self._context.ros, self._context.wall_ns()
            self._publisher.publish(ros.serialize(_TYPE, diagnostics(snapshot), now))
        except (RosError, FieldError) as error:
            self._failed(str(error))

    def _bridged(self, snapshot: Snapshot) -> bool:
        """Whether this bridge itself takes the topic to another domain."""
        topic = self._context.session.diagnostics_topic
        return any(route.outgoing and route.topic == topic for route in snapshot.routes)

    def _failed(self, why: str, level: Level = Level.WARNING) -> None:
        text = f"nothing is published on {self._context.session.diagnostics_topic}: {why}"
        self._context.log(level, EventCode.ENGINE_DIAGNOSTICS, text)
        self.close()

    def close(self) -> None:
        """Publish no more. May be called twice."""
        if self._publisher is not None:
            self._context.announcements.withdraw(self._publisher.gid)
            self._publisher.close()
            self._publisher = None
