"""The names of `rsb_bridge` that features may use; they stay as long as `Feature.API` does.

A name is imported when it is first used: a feature that a session does not use costs nothing. For mypy the same names
are imported above their table; a test compares the two. `rsb_console.feature_console` has those of consoles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature import late_names

if TYPE_CHECKING:
    from rsb_bridge.api import EngineApi, EngineError, Unable
    from rsb_bridge.config.files import file_stem, make_folder, replace_file, sync_folder, typed_path, why_not_written
    from rsb_bridge.config.programs import program_path, program_problem, program_warnings
    from rsb_bridge.config.rights import DeniedUse, Rights
    from rsb_bridge.config.session_file import SessionError, load
    from rsb_bridge.config.state_folder import state_folder
    from rsb_bridge.config.yaml_text import dump_yaml
    from rsb_bridge.context import Context
    from rsb_bridge.control.bridges import running_bridges
    from rsb_bridge.control.control_server import ControlServer
    from rsb_bridge.control.remote_engine import RemoteEngine, attach
    from rsb_bridge.engine import Engine
    from rsb_bridge.engine.bridge import Bridge
    from rsb_bridge.engine.part import EngineObserver, EnginePart, MovingPart
    from rsb_bridge.feature import EntryKey, Feature, MachineReport, PeerRight, SessionKey, ShownField
    from rsb_bridge.link.armed_nodes import are_parameters_open, armed_of_nodes
    from rsb_bridge.link.extension import Extension, LinkError, check_names
    from rsb_bridge.link.internal_routes import InternalRoutes
    from rsb_bridge.link.link import Link, link_named
    from rsb_bridge.link.orders import Asker, OrderExtension, OrderProblem
    from rsb_bridge.link.questions import AskingExtension, Questions
    from rsb_bridge.model.budgets import TokenBucket
    from rsb_bridge.model.clock import Clock
    from rsb_bridge.model.codes import EventCode
    from rsb_bridge.model.commands import Command, Effect, Right, operator
    from rsb_bridge.model.finding import Check, Finding, Grade
    from rsb_bridge.model.limits import SAFE_DOMAIN, TEXT_LENGTH, Range
    from rsb_bridge.model.names import other_side
    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.model.robot_summary import RobotState, RobotSummary
    from rsb_bridge.model.session import Client, Session, Topic
    from rsb_bridge.model.snapshot import Event, Level, LinkSnapshot, RouteSnapshot, Snapshot, State
    from rsb_bridge.model.text import escape_text, join_first, one_line, plural, sanitize_text
    from rsb_bridge.model.transport_traits import TransportTraits
    from rsb_bridge.model.verdict import LASTING, Cause, Verdict
    from rsb_bridge.model.wording import Wording
    from rsb_bridge.ros.internal_ends import BytesDrain, BytesSource
    from rsb_bridge.ros.ros_interface import Endpoint, Publisher, RawMessage, RosError, TopicSpec
    from rsb_bridge.route.message_transform import MessageTransform, TransformError
    from rsb_bridge.route.peeking import Tap
    from rsb_bridge.route.receiver import Receiver
    from rsb_bridge.route.route import Route
    from rsb_bridge.route.sender import Sender
    from rsb_bridge.tasks import in_thread
    from rsb_bridge.telemetry.event_log import EventLog
    from rsb_bridge.transport.transport import Transport
    from rsb_bridge.wire.messages import ControlMessageBase
    from rsb_bridge.wire.order_messages import (
        TICKET_WITHIN,
        OrderAnswer,
        OrderBase,
        OrderEnd,
        OrderQuestion,
    )
    from rsb_bridge.wire.records import PRINTABLE, Count, Name, OrderOutcome, Reason, RouteId, Seconds

_NAMES = {
    "rsb_bridge.api": ("EngineApi", "EngineError", "Unable"),
    "rsb_bridge.config.files": (
        "file_stem",
        "make_folder",
        "replace_file",
        "sync_folder",
        "typed_path",
        "why_not_written",
    ),
    "rsb_bridge.config.programs": ("program_path", "program_problem", "program_warnings"),
    "rsb_bridge.config.rights": ("DeniedUse", "Rights"),
    "rsb_bridge.config.session_file": ("SessionError", "load"),
    "rsb_bridge.config.state_folder": ("state_folder",),
    "rsb_bridge.config.yaml_text": ("dump_yaml",),
    "rsb_bridge.context": ("Context",),
    "rsb_bridge.control.bridges": ("running_bridges",),
    "rsb_bridge.control.control_server": ("ControlServer",),
    "rsb_bridge.control.remote_engine": ("RemoteEngine", "attach"),
    "rsb_bridge.engine": ("Engine",),
    "rsb_bridge.engine.bridge": ("Bridge",),
    "rsb_bridge.engine.part": ("EngineObserver", "EnginePart", "MovingPart"),
    "rsb_bridge.feature": ("EntryKey", "Feature", "MachineReport", "PeerRight", "SessionKey", "ShownField"),
    "rsb_bridge.link.armed_nodes": ("are_parameters_open", "armed_of_nodes"),
    "rsb_bridge.link.extension": ("Extension", "LinkError", "check_names"),
    "rsb_bridge.link.internal_routes": ("InternalRoutes",),
    "rsb_bridge.link.link": ("Link", "link_named"),
    "rsb_bridge.link.orders": ("Asker", "OrderExtension", "OrderProblem"),
    "rsb_bridge.link.questions": ("AskingExtension", "Questions"),
    "rsb_bridge.model.budgets": ("TokenBucket",),
    "rsb_bridge.model.clock": ("Clock",),
    "rsb_bridge.model.codes": ("EventCode",),
    "rsb_bridge.model.commands": ("Command", "Effect", "Right", "operator"),
    "rsb_bridge.model.finding": ("Check", "Finding", "Grade"),
    "rsb_bridge.model.limits": ("SAFE_DOMAIN", "TEXT_LENGTH", "Range"),
    "rsb_bridge.model.names": ("other_side",),
    "rsb_bridge.model.purposes": ("Purpose",),
    "rsb_bridge.model.qos": ("Qos",),
    "rsb_bridge.model.robot_summary": ("RobotState", "RobotSummary"),
    "rsb_bridge.model.session": ("Client", "Session", "Topic"),
    "rsb_bridge.model.snapshot": ("Event", "Level", "LinkSnapshot", "RouteSnapshot", "Snapshot", "State"),
    "rsb_bridge.model.text": ("escape_text", "join_first", "one_line", "plural", "sanitize_text"),
    "rsb_bridge.model.transport_traits": ("TransportTraits",),
    "rsb_bridge.model.verdict": ("LASTING", "Cause", "Verdict"),
    "rsb_bridge.model.wording": ("Wording",),
    "rsb_bridge.ros.internal_ends": ("BytesDrain", "BytesSource"),
    "rsb_bridge.ros.ros_interface": ("Endpoint", "Publisher", "RawMessage", "RosError", "TopicSpec"),
    "rsb_bridge.route.message_transform": ("MessageTransform", "TransformError"),
    "rsb_bridge.route.peeking": ("Tap",),
    "rsb_bridge.route.receiver": ("Receiver",),
    "rsb_bridge.route.route": ("Route",),
    "rsb_bridge.route.sender": ("Sender",),
    "rsb_bridge.tasks": ("in_thread",),
    "rsb_bridge.telemetry.event_log": ("EventLog",),
    "rsb_bridge.transport.transport": ("Transport",),
    "rsb_bridge.wire.messages": ("ControlMessageBase",),
    "rsb_bridge.wire.order_messages": (
        "TICKET_WITHIN",
        "OrderBase",
        "OrderAnswer",
        "OrderEnd",
        "OrderQuestion",
    ),
    "rsb_bridge.wire.records": ("PRINTABLE", "Count", "Name", "OrderOutcome", "Reason", "RouteId", "Seconds"),
}
__getattr__ = late_names(__name__, _NAMES)
