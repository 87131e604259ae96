"""The names of `rsb_console` that features may use, as `rsb_bridge.feature_api` has those of bridges."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature import late_names

if TYPE_CHECKING:
    from rsb_console.actions.action import Action, Beginning, CameraSight, Group, KeyChapter, OnNode, OnRobot, late
    from rsb_console.actions.all_actions import ACTIONS
    from rsb_console.command.argument_values import count, seconds, topic_pattern, within
    from rsb_console.command.formatting import json_line, json_value
    from rsb_console.command.remote_arguments import (
        EXIT,
        NO_BRIDGE,
        AddCommand,
        Complete,
        bridge_commands,
        bridge_options,
        inherit_bridge_options,
        named_bridge_options,
        route_arguments,
        side_options,
        subcommand,
    )
    from rsb_console.command.shell import (
        FAILURE,
        INTERRUPTED,
        OK,
        USAGE,
        print_error,
        print_line,
        print_lines,
        redraw_line,
    )
    from rsb_console.command.sides import chosen_side, print_problems, problems_of, table_lines
    from rsb_console.command.target import (
        NoBridgeError,
        UsageError,
        agreed,
        attached,
        chosen_route,
        done,
        done_with,
        failed,
        result,
    )
    from rsb_console.command.ways import RemoteWay
    from rsb_console.console_api import Console
    from rsb_console.notation.console_setting import ConsoleSetting
    from rsb_console.notation.formats import time_of_day
    from rsb_console.notation.glyphs import DONE, FAILED, STATE_SIGN, STATE_WORD, sparkline
    from rsb_console.notation.link_fact import LinkFact
    from rsb_console.notation.route_fact import RouteFact
    from rsb_console.notation.side_answer import SideText, side_of
    from rsb_console.notation.topic_column import TopicColumn
    from rsb_console.preferences import Preferences
    from rsb_console.screens.dialog import ConfirmScreen, Dialog, FullScreen, SideBox
    from rsb_console.screens.filtered_screen import FilteredScreen
    from rsb_console.screens.main import MainScreen
    from rsb_console.screens.message_screen import MessageView
    from rsb_console.screens.sides_screen import SidesScreen, asked_link
    from rsb_console.session.parameter_files import WrittenValue, parameters_text, read_parameter_file
    from rsb_console.session.parameter_values import parameter_value, shown_value
    from rsb_console.terminal.input_queue import DIALOG, GuardedScreen
    from rsb_console.terminal_app import TerminalApp
    from rsb_console.widgets.cell_table import CellTable
    from rsb_console.widgets.filter import Prompt, RowFilter
    from rsb_console.widgets.form import Field, FormScreen, Spec
    from rsb_console.widgets.lines import FixedLines, Line, ScrolledLines, clip, fit, wrapped
    from rsb_console.widgets.look_option import LookOption, look_options
    from rsb_console.widgets.picker import Suggestion
    from rsb_console.widgets.selectable_list import SelectableList
    from rsb_console.widgets.tile_lines import TileLines, added_tiles

_NAMES = {
    "rsb_console.actions.all_actions": ("ACTIONS",),
    "rsb_console.actions.action": (
        "Action",
        "Beginning",
        "Group",
        "KeyChapter",
        "OnNode",
        "OnRobot",
        "CameraSight",
        "late",
    ),
    "rsb_console.command.argument_values": ("count", "seconds", "topic_pattern", "within"),
    "rsb_console.command.formatting": ("json_line", "json_value"),
    "rsb_console.command.remote_arguments": (
        "EXIT",
        "NO_BRIDGE",
        "AddCommand",
        "Complete",
        "bridge_commands",
        "bridge_options",
        "inherit_bridge_options",
        "named_bridge_options",
        "route_arguments",
        "side_options",
        "subcommand",
    ),
    "rsb_console.command.shell": (
        "FAILURE",
        "INTERRUPTED",
        "OK",
        "USAGE",
        "print_error",
        "print_line",
        "print_lines",
        "redraw_line",
    ),
    "rsb_console.command.sides": ("chosen_side", "print_problems", "problems_of", "table_lines"),
    "rsb_console.command.target": (
        "NoBridgeError",
        "UsageError",
        "agreed",
        "attached",
        "chosen_route",
        "done",
        "done_with",
        "failed",
        "result",
    ),
    "rsb_console.command.ways": ("RemoteWay",),
    "rsb_console.console_api": ("Console",),
    "rsb_console.notation.console_setting": ("ConsoleSetting",),
    "rsb_console.notation.formats": ("time_of_day",),
    "rsb_console.notation.glyphs": ("DONE", "FAILED", "STATE_SIGN", "STATE_WORD", "sparkline"),
    "rsb_console.notation.link_fact": ("LinkFact",),
    "rsb_console.notation.route_fact": ("RouteFact",),
    "rsb_console.notation.side_answer": ("SideText", "side_of"),
    "rsb_console.notation.topic_column": ("TopicColumn",),
    "rsb_console.preferences": ("Preferences",),
    "rsb_console.screens.dialog": ("ConfirmScreen", "Dialog", "FullScreen", "SideBox"),
    "rsb_console.screens.filtered_screen": ("FilteredScreen",),
    "rsb_console.screens.main": ("MainScreen",),
    "rsb_console.screens.sides_screen": ("SidesScreen", "asked_link"),
    "rsb_console.screens.message_screen": ("MessageView",),
    "rsb_console.session.parameter_files": ("WrittenValue", "parameters_text", "read_parameter_file"),
    "rsb_console.session.parameter_values": ("parameter_value", "shown_value"),
    "rsb_console.terminal.input_queue": ("DIALOG", "GuardedScreen"),
    "rsb_console.terminal_app": ("TerminalApp",),
    "rsb_console.widgets.cell_table": ("CellTable",),
    "rsb_console.widgets.filter": ("Prompt", "RowFilter"),
    "rsb_console.widgets.form": ("Field", "FormScreen", "Spec"),
    "rsb_console.widgets.lines": ("FixedLines", "Line", "ScrolledLines", "clip", "fit", "wrapped"),
    "rsb_console.widgets.look_option": ("LookOption", "look_options"),
    "rsb_console.widgets.picker": ("Suggestion",),
    "rsb_console.widgets.selectable_list": ("SelectableList",),
    "rsb_console.widgets.tile_lines": ("TileLines", "added_tiles"),
}
__getattr__ = late_names(__name__, _NAMES)
