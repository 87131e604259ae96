"""Own commands: keys of the console that run an operator's shell commands, as ``console.yaml`` lists them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Feature

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rsb_console.feature_console import Action, ConsoleSetting, Preferences
    from rsb_extras.own_commands.own_command import OwnCommand


class OwnCommands(Feature):
    name = "own_commands"

    def console_settings(self) -> Iterable[ConsoleSetting[tuple[OwnCommand, ...]]]:
        from rsb_extras.own_commands.own_command import COMMANDS  # noqa: PLC0415 -- `Feature` says why, here and below

        return (COMMANDS,)

    def own_actions(self, preferences: Preferences) -> Iterable[Action]:
        from rsb_extras.own_commands.own_command import COMMANDS, CommandMistake, action_of  # noqa: PLC0415

        commands = COMMANDS.of(preferences)
        if commands and (reason := preferences.change_by_others()):
            # They would run with this user's rights: with root's, in a console that has kept another user's home.
            preferences.problems.append((CommandMistake.LEFT_OUT(), CommandMistake.OF_OTHERS(reason=reason)))
            return ()
        return map(action_of, commands)


FEATURE = OwnCommands()
