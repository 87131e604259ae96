"""Audit: compares a recording of each side of any bridge, and says of each topic what did not cross."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rsb_console.feature_console import AddCommand, Complete


class AuditFeature(Feature):
    name = "audit"
    needs = ("recording",)
    libraries: ClassVar[Mapping[str, str]] = {"record": "mcap"}

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.audit.audit_arguments import add_audit_command  # noqa: PLC0415 -- `Feature` says why

        add_audit_command(add, complete)


FEATURE = AuditFeature()
