"""A door for programs: the Model Context Protocol, by which they look at a running bridge over stdin and stdout."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rsb_console.feature_console import AddCommand, Complete


class McpServer(Feature):
    name = "mcp_server"
    libraries: ClassVar[Mapping[str, str]] = {"mcp": "mcp"}

    def subcommands(self, add: AddCommand, complete: Complete) -> None:
        from rsb_extras.mcp_server.mcp_arguments import add_mcp  # noqa: PLC0415 -- `Feature` says why

        add_mcp(add, complete)


FEATURE = McpServer()
