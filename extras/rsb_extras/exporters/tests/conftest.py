"""Surroundings of the engines that have the exporters, as those of all engines."""

from __future__ import annotations

from tests.command.conftest import here, ran
from tests.engine.conftest import _answers_take_their_time, consoles

from rsb_extras.driving.tests.conftest import long_lease

__all__ = ["_answers_take_their_time", "consoles", "here", "long_lease", "ran"]
