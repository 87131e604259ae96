"""The description for the package index: README.md, with absolute addresses in place of those within the repository."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?!https?:|#)(?P<path>[^)]+)\)")


def absolute(text: str, repository: str) -> str:
    """Return a document's text with absolute addresses of pictures and pages."""
    raw = repository.replace("github.com", "raw.githubusercontent.com")

    def link(found: re.Match[str]) -> str:
        place = f"{raw}/HEAD" if found["picture"] else f"{repository}/blob/HEAD"
        return f"{found['picture']}[{found['text']}]({place}/{found['path']})"

    return LINK.sub(link, text)


class Hook(MetadataHookInterface):
    """Adds the description to the metadata."""

    def update(self, metadata: dict[str, Any]) -> None:
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": absolute(text, metadata["urls"]["Repository"]),
        }
