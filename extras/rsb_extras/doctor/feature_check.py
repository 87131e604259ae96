"""Findings about the installed features: what of them is left out, and why."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from rsb_bridge.control import protocol
from rsb_bridge.feature_api import Finding, Grade
from rsb_bridge.installed_features import added, feature_faults, feature_names, installed
from rsb_bridge.model.purposes import purposes
from rsb_bridge.wire.codec import control_messages
from rsb_console.actions.all_actions import screens
from rsb_console.command.ways import ways
from rsb_console.notation import link_fact, topic_column
from rsb_console.notation.console_setting import feature_settings

if TYPE_CHECKING:
    from collections.abc import Iterator

_ASKED_AS_IMPORTED = (protocol, topic_column, link_fact)
"""Modules that ask the features for commands, columns and facts of links."""


def features() -> Iterator[Finding]:
    """Ask the features for all that needs no session, and yield what has been left out so far."""
    for ask in (purposes, control_messages, screens, ways, feature_settings):
        ask()
    added("message_views")
    for each in feature_faults():
        yield Finding("features", Grade.WARNING, "features", str(each), facts=asdict(each))
    if not feature_faults():
        facts = {"names": feature_names()}
        yield Finding("features", Grade.OK, "features", f"{len(installed())} installed", facts=facts)
