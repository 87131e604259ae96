"""One version, one home and one address, wherever they are written; what is not tagged is called unreleased."""

from __future__ import annotations

import re
import runpy
import sys
import tomllib
import xml.etree.ElementTree as ET
from html import unescape
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import rsb_bridge

if TYPE_CHECKING:
    import pytest

ROOT = Path(__file__).parents[2]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSION: str = PROJECT["version"]
NUMBER = VERSION.partition(".dev")[0]
UNRELEASED = VERSION != NUMBER
PICTURES = [each for folder in ("docs", "extras/rsb_extras/*/docs") for each in ROOT.glob(f"{folder}/pictures/*.svg")]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    *ROOT.glob("docs/*.md"),
    *ROOT.glob("extras/rsb_extras/*/docs/*.md"),
]
PICTURES = [*ROOT.glob("docs/pictures/*.svg"), *ROOT.glob("extras/rsb_extras/*/docs/pictures/*.svg")]


def read(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


def test_the_version_is_the_same_everywhere() -> None:
    """ROS's packages have three numbers, and no word for what is not released."""
    assert re.fullmatch(r"\d+\.\d+\.\d+", NUMBER)
    assert rsb_bridge.__version__ == VERSION
    assert ET.fromstring(read("ros/package.xml")).findtext("version") == NUMBER
    assert f'version="{NUMBER}"' in read("ros/setup.py")


def test_what_is_not_tagged_is_called_unreleased() -> None:
    headings = re.findall(r"^## (.+)$", read("CHANGELOG.md"), re.MULTILINE)
    assert headings[0] == ("Unreleased" if UNRELEASED else NUMBER)
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", each) for each in headings[1:])
    assert ("There is no release yet" in read("README.md")) == UNRELEASED


def test_no_page_names_a_file_of_a_version() -> None:
    for page in PAGES:
        assert not re.search(r"rsb[-_]console[-_]v?\d", page.read_text(encoding="utf-8")), page


def test_pictures_show_this_version() -> None:
    shown = {
        picture.name: re.findall(
            r"rsb-console (\d[\w.]*)", unescape(picture.read_text(encoding="utf-8")).replace("\xa0", " ")
        )
        for picture in PICTURES
    }
    assert any(shown.values()) or not (ROOT / "extras").exists()  # those that show it are features'
    for name, versions in shown.items():
        current = {VERSION} if UNRELEASED else {NUMBER, f"{NUMBER}.dev0"}  # a release keeps its earlier entries
        assert set(versions) <= current, f"{name}: make screenshots"


def test_no_picture_cuts_the_version() -> None:
    for picture in PICTURES:
        assert not re.search(rf"\b{re.escape(NUMBER)}[^<\s]*…", unescape(picture.read_text(encoding="utf-8"))), picture


def test_pages_name_the_size_that_the_installation_names() -> None:
    size = re.search(r"^SIZE = (\d+)", read(".ci/install.py"), re.MULTILINE)
    assert size
    for page in ("README.md", "docs/install.md"):
        assert re.findall(r"(\d+) MB(?= into a cache|, ROS)", read(page).replace("\n", " ")) == [size[1]], page


def test_there_is_one_home_and_one_address() -> None:
    home, address = PROJECT["urls"]["Repository"], PROJECT["authors"][0]["email"]
    assert not address.endswith(".invalid")
    package = ET.fromstring(read("ros/package.xml"))
    assert [each.get("email") for each in package.iter("maintainer")] == [address]
    assert package.findtext("url[@type='repository']") == home
    assert all(url.startswith(home) for url in PROJECT["urls"].values())
    assert f"<{address}>" in read("deb/build.py")
    assert f"Homepage: {home}\n" in read("deb/build.py")


def test_the_package_index_shows_pictures_and_links(monkeypatch: pytest.MonkeyPatch) -> None:
    interface = ModuleType("hatchling.metadata.plugin.interface")
    interface.MetadataHookInterface = object  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, interface.__name__, interface)
    absolute = runpy.run_path(str(ROOT / "hatch_build.py"))["absolute"]
    shown = absolute(read("README.md"), PROJECT["urls"]["Repository"])
    links = re.findall(r"(!?)\[[^\]]*\]\(([^)]+)\)", shown)
    assert all(target.startswith("https://") for _, target in links)
    pictures = [target for picture, target in links if picture]
    assert pictures
    for target in pictures:
        assert target.startswith("https://raw.githubusercontent.com/")
        name = target.partition("/HEAD/")[2]
        assert (ROOT / name).is_file() or not (ROOT / "extras").exists()
