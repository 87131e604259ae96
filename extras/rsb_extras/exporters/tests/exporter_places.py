"""Names of the exporters that their tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

METRICS_APPLICATION = Place("rsb_extras.exporters.metrics", "application")
METRICS_END_WITHIN = Place("rsb_extras.exporters.metrics_exporter", "_ENDS_WITHIN")
METRICS_RETRIED_EVERY = Place("rsb_extras.exporters.metrics_exporter", "_RETRIED_EVERY")
DIAGNOSTICS_TYPE = Place("rsb_extras.exporters.ros_topics", "_TYPE")
FAULT_COMMAND_RUNS_FOR = Place("rsb_extras.exporters.fault_hook", "RUNS_FOR")
FAULT_COMMAND_ENDS_WITHIN = Place("rsb_extras.exporters.fault_hook", "_ENDS_WITHIN")
SIGNAL_GROUP = Place("rsb_extras.exporters.fault_hook", "_signal_group")
