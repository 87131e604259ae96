"""The session files that this user has opened last."""

from __future__ import annotations

from pathlib import Path

from platformdirs import user_state_path

from rsb_bridge.config.files import make_folder, replace_file

LIMIT = 20  # sessions that are remembered; a round figure: the list has a filter


def recents_path() -> Path:
    return user_state_path("rsb-console") / "recent-sessions"


def recent_sessions() -> list[Path]:
    """Return the recent session files that still exist, the newest first."""
    try:
        lines = recents_path().read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return []
    return [path for line in lines if (path := Path(line)).is_file()]


def remember(path: Path) -> None:
    """Put a session file first.

    Raises:
        OSError: the list could not be written.
    """
    # A relative path would mean another file in another folder.
    path = path.resolve()
    newest = [path, *(other for other in recent_sessions() if other != path)][:LIMIT]
    make_folder(recents_path().parent)
    replace_file(recents_path(), "".join(f"{each}\n" for each in newest).encode())
