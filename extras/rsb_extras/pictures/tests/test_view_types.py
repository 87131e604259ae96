"""Other packages add views by entry points."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from diagnostic_msgs.msg import KeyValue
from sensor_msgs.msg import LaserScan
from std_msgs.msg import ColorRGBA

from rsb_extras.pictures.picture import Wish
from rsb_extras.pictures.tests.samples import cells_of, task
from rsb_extras.pictures.worker import Undrawable

if TYPE_CHECKING:
    from rsb_extras.pictures.picture import Picture
    from rsb_extras.pictures.renderer import Renderer
    from rsb_extras.pictures.worker import Task

pytestmark = pytest.mark.usefixtures("package")
VIEW = """
from rsb_extras.pictures.drawing import Drawn, View, text

class KeyView(View):
    said = ""

    def receive(self, received):
        self.said = text(received.message, "key")

    def draw(self, wish):
        return Drawn(notes=("keys: " + self.said,))
"""
ENTRIES = """
[rsb_console.views]
diagnostic_msgs/msg/KeyValue = added_view:KeyView
sensor_msgs/msg/LaserScan = added_view:KeyView
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installed package with a view, as far as importlib can tell."""
    about = tmp_path / "added_view-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: added-view\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text(ENTRIES, encoding="utf-8")
    (tmp_path / "added_view.py").write_text(VIEW, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{':'.join(each for each in sys.path if each)}")
    return tmp_path


def drawn(renderer: Renderer, of: Task) -> Picture:
    return asyncio.run(renderer.draw(of))


def test_view_of_other_package_draws_confined(renderer: Renderer) -> None:
    picture = drawn(renderer, task(Wish(), KeyValue(key="k", value="v")))
    assert (picture.notes, picture.problem) == (("keys: k",), "")


def test_view_of_the_docs_draws(package: Path, renderer: Renderer) -> None:
    page = (Path(__file__).parents[1] / "docs" / "views.md").read_text(encoding="utf-8")
    blocks = dict(re.findall(r"^```(toml|python)\n# \S+\n(.*?)^```$", page, re.MULTILINE | re.DOTALL))
    entries = tomllib.loads(blocks["toml"])["project"]["entry-points"]["rsb_console.views"]
    lines = "\n".join(f"{name} = {place}" for name, place in entries.items())
    (package / "added_view-1.0.dist-info" / "entry_points.txt").write_text(f"[rsb_console.views]\n{lines}\n")
    (package / "my_package").mkdir()
    (package / "my_package" / "swatch.py").write_text(blocks["python"], encoding="utf-8")
    picture = drawn(renderer, task(Wish(width=4, height=2), ColorRGBA(r=1.0, b=0.5)))
    assert (picture.notes, picture.problem) == (("#ff0080",), "")
    assert cells_of(picture).rows == ("████",) * 2


def test_this_programs_views_stay(renderer: Renderer) -> None:
    picture = drawn(renderer, task(Wish(), LaserScan(range_max=1.0)))
    assert not any("keys" in each for each in picture.notes)


def test_the_console_opens_them_as_pictures() -> None:
    has = ", ".join(f"has_picture('{each}')" for each in ("diagnostic_msgs/msg/KeyValue", "my_msgs/msg/Other"))
    command = [sys.executable, "-c", f"from rsb_extras.pictures.look_screen import has_picture; print({has})"]
    assert subprocess.run(command, capture_output=True, check=True).stdout == b"True False\n"


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("added_view", None),
        ("thermal_colours", "import thermal_colours\n" + VIEW),
        ("thermal_colours", VIEW.replace("return Drawn", "import thermal_colours; return Drawn")),
    ],
    ids=["its own", "at import", "while it draws"],
)
def test_missing_module_of_another_packages_view_names_both(
    module: str, source: str | None, package: Path, renderer: Renderer
) -> None:
    (package / "added_view.py").unlink()
    if source is not None:
        (package / "added_view.py").write_text(source, encoding="utf-8")
    asked = task(Wish(), KeyValue(key="k", value="v"))
    (sample,) = asked.samples
    assert drawn(renderer, asked).problem == Undrawable.MODULE_MISSING(
        how="diagnostic_msgs/msg/KeyValue", package="added-view", module=module, topic=sample.topic
    )
