"""The description for the package index, README.md with absolute addresses, and the features that are in this tree."""

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


def features(root: str) -> dict[str, str]:
    """Return the entry points of the features, one for each folder of `extras/rsb_extras`."""
    folders = sorted(each.parent.name for each in Path(root, "extras/rsb_extras").glob("*/__init__.py"))
    return {name: f"rsb_extras.{name}:FEATURE" for name in folders}


class Hook(MetadataHookInterface):
    """Adds the description and the features to the metadata."""

    def update(self, metadata: dict[str, Any]) -> None:
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": absolute(text, metadata["urls"]["Repository"]),
        }
        metadata["entry-points"] = {"rsb_console.feature": features(self.root)}
