"""The terminal app that shows one recording, without a bridge."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from rsb_console.command import app_run
from rsb_console.feature_console import TerminalApp
from rsb_console.notation.ascii_signs import prefers_ascii
from rsb_console.terminal_app import ShutdownReason
from rsb_extras.playing.review_screen import ReviewScreen

if TYPE_CHECKING:
    from pathlib import Path

    from rsb_extras.recording.reading.open_recording import OpenRecording


class ReviewApp(TerminalApp[None]):
    """Shows a recording until the operator leaves."""

    def __init__(
        self,
        recording: OpenRecording,
        topic: str,
        at: int | None,
        *,
        ascii_only: bool,
        theme: str | None = None,
        config: Path | None = None,
    ) -> None:
        super().__init__(readonly=True, ascii_only=ascii_only, theme=theme, config=config)
        self._review = ReviewScreen(recording, topic, at)

    def on_mount(self) -> None:
        super().on_mount()
        self.push_screen(self._review, lambda _: self.shut_down(ShutdownReason.QUIT))

    def stop(self) -> None:
        """Nothing stays open."""

    def pull(self) -> None:
        """Nothing changes by itself."""


def run_review(
    recording: OpenRecording, topic: str, at: int | None, *, ascii_only: bool, theme: str | None, mouse: bool
) -> int:
    """Show a recording, and return the exit code."""
    app = ReviewApp(recording, topic, at, ascii_only=ascii_only or prefers_ascii(os.environ), theme=theme)
    app_run.run_app(app, mouse=mouse)
    return app_run.exit_code(app)
