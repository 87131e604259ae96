"""Saving the session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rsb_bridge.model.commands import Effect, Save
from rsb_bridge.model.wording import Wording
from rsb_console.actions.action import FooterEntry
from rsb_console.notation import formats
from rsb_console.operations.bridge_operations import reload
from rsb_console.screens.dialog import ConfirmScreen

if TYPE_CHECKING:
    from rsb_console.console_api import Console
    from rsb_console.screens.main import MainScreen


class SaveQuestion(Wording):
    """Questions about saving, and what is not saved."""

    UNNAMED = "its session differs from its file"
    ONLY_THERE = (
        "nothing is unsaved here. The change that was made here is in the session of {name}: save it there, "
        "with w in a console of its bridge or rsb-console save, or its restart loses it"
    )
    SAVE_THERE = "Save the session of {name} to its file?"
    SAVES_THERE = "The bridge writes the file on its machine. Comments stay, and a backup is kept there."


def not_saved(console: Console) -> str:
    """Return in words what is in no file, or an empty string."""
    from rsb_console.session.saving import file_of, unsaved  # noqa: PLC0415 -- keeps the start short

    engine, saved, path = console.engine, console.saved, console.path
    if engine is None or (path is not None and not console.snapshot().unsaved):
        return ""
    if saved is None:
        return SaveQuestion.UNNAMED() if console.snapshot().unsaved else ""
    # Somebody else may have saved the same.
    if path is not None and file_of(path, engine.session) is not None:
        return ""
    return unsaved(saved, engine.session)


async def save(screen: MainScreen) -> None:
    """Save the session with the topics it has now."""
    console = screen.console
    now = console.snapshot()
    if not now.unsaved and (there := formats.unsaved_there(now)):
        console.notify(SaveQuestion.ONLY_THERE(name=there), severity="warning")
    elif console.path is not None:
        await _save_to(screen, console.path)
    elif now.unsaved:
        await _save_there(console)
    else:
        await save_as(screen)


async def _save_there(console: Console) -> None:
    """Have a bridge on another machine save its session."""
    engine, title = console.engine, SaveQuestion.SAVE_THERE(name=console.attached_to)
    question = ConfirmScreen(title, SaveQuestion.SAVES_THERE(), "Save", Effect.LOSES)
    if engine is not None and await console.ask(question):
        await console.command(engine.do(Save()), "saved")


async def save_as(screen: MainScreen) -> None:
    from rsb_console.screens.save_screens import SaveAsScreen  # noqa: PLC0415 -- keeps the start short

    console = screen.console
    engine = console.engine
    if engine is None:
        console.notify("nothing to save: no session runs")
        return
    path: Path | None = console.path or Path(f"{engine.session.name}.yaml")
    while path is not None and (path := await console.ask(SaveAsScreen(path))) is not None:
        if await _save_to(screen, path):
            return


async def _save_to(screen: MainScreen, path: Path) -> bool:
    """Save the session to a file. Return False if the operator may name another one."""
    from rsb_bridge.config.session_file import open_file  # noqa: PLC0415 -- not needed without a file
    from rsb_console.screens.save_screens import ChangedScreen, save_elsewhere  # noqa: PLC0415 -- keeps the start short
    from rsb_console.session.saving import file_of, is_changed  # noqa: PLC0415 -- keeps the start short

    console = screen.console
    engine, opened = console.engine, console.file
    if engine is None:
        return True
    session = engine.session
    if opened is not None and opened.is_at(path) and is_changed(opened):
        # Nothing of somebody else's is lost if the file says what runs, or still what it said when it was opened.
        if file_of(path, session) is None and file_of(path, opened.session) is None:
            match await console.ask(ChangedScreen(path)):
                case "reload":
                    await reload(screen)
                    return True
                case "save_as":
                    await save_as(screen)
                    return True
                case "overwrite":
                    pass
                case _:
                    return False
        # This keeps the comments that the file has now.
        opened = open_file(path)
    if await save_elsewhere(console, session, path, opened):
        console.saved_to(session, path)
        own = console.path
        if console.attached_to and own is not None and own.resolve() == path.resolve():  # noqa: ASYNC240 -- as all files of a session here
            await console.command(engine.do(Save()))  # it finds its session in the file
        return True
    return False


def save_in_footer(screen: MainScreen) -> FooterEntry | None:
    now = screen.console.snapshot()
    return FooterEntry("save", keeps_place=True) if now.unsaved or formats.unsaved_there(now) else None
