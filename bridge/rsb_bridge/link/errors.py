"""What a link refuses."""

from __future__ import annotations


class LinkError(Exception):
    """A link cannot do what was asked; the message says why."""
