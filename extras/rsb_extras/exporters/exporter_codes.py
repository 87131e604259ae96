"""Codes of the exporters' events."""

from __future__ import annotations

from enum import StrEnum


class ExporterCode(StrEnum):
    DIAGNOSTICS = "engine.diagnostics"
    """Nothing is published on the diagnostics topic or the driver topic; the text says why."""
    METRICS = "engine.metrics"
    """Metrics are served, or are not; the text says where, or why."""
    ON_FAULT = "engine.on_fault"
    """The session's `on_fault` command cannot be run, failed or took too long; at debug level, its output."""
