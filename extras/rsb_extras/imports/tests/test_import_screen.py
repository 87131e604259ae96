"""Another bridge's file imported from the console: real files, and words for what is wrong with them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.console.driving import engine_of, fill, form_of, gone, on_welcome, shown, until

from rsb_bridge.config.session_file import load
from rsb_bridge.model.session import Topic
from rsb_console.screens.session_files import FileText

if TYPE_CHECKING:
    from textual.pilot import Pilot

    from rsb_console.app import ConsoleApp

BRINGUP = """\
client_node:
  ros__parameters:
    server_ip: '192.168.10.250'
    server_port: 3000
    transmit_topics: ['scan']
    transmit_msg_types: ['LaserScan']
    transmit_ports: [12004]
    transmit_protocols: ['{protocol}']
    transmit_qos: ['qos_profile_sensor_data']
"""

pytestmark = pytest.mark.usefixtures("folder")


@on_welcome(landmark="Import")
async def test_a_thesis_file_becomes_a_session(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    (folder / "config").mkdir()
    (folder / "config" / "bringup.yaml").write_text(BRINGUP.format(protocol="UDP"))
    await pilot.press("i", *"bri", "enter")
    await until(pilot, lambda: form_of(app).fields["name"].control.has_focus, "the next field")
    await fill(pilot, name="robot1", path="robot1.yaml", domain_id="x")
    await pilot.press("enter")
    await shown(pilot, "'x' is not a whole number")
    await fill(pilot, domain_id="7")
    await pilot.press("enter")
    await shown(pilot, "Imported. Run robot1.yaml?")
    await pilot.press("n")
    await gone(pilot, "Imported. Run robot1.yaml?")
    assert form_of(app).values["name"] == "robot1", "the form is still there"
    await pilot.press("enter")
    await shown(pilot, "Imported. Run robot1.yaml?")
    await pilot.press("y")
    await until(pilot, lambda: app.engine is not None, "an engine")
    imported = load(folder / "robot1.yaml")
    expected = Topic("/scan", "transmit", "sensor_msgs/msg/LaserScan", "udp", 12004, "sensor_data")
    assert imported == engine_of(app).session
    assert imported.topics == (expected,)
    assert imported.domain_id == 7


@pytest.fixture
def robots(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Another folder than the working one, the user's home, with a thesis file."""
    path = folder.parent / "robots"
    path.mkdir()
    (path / "nav.yaml").write_text(BRINGUP.format(protocol="UDP"))
    monkeypatch.setenv("HOME", str(path))
    return path


@pytest.mark.parametrize("typed", ["../robots/nav.yaml", "~/nav.yaml  "])
@on_welcome()
async def test_existing_file_is_not_called_missing(
    app: ConsoleApp, pilot: Pilot[None], robots: Path, typed: str
) -> None:
    await pilot.press("i")
    await shown(pilot, "config/bringup.yaml")
    await fill(pilot, bringup=typed)
    await shown(pilot, FileText.EXISTS)
    await gone(pilot, "no such file")
    await pilot.press("enter")
    form = form_of(app)
    await until(pilot, lambda: form.fields["name"].control.has_focus, "the next field")
    assert form.values["name"] == "nav"
    await fill(pilot, name="robot1")
    (robots / "map.yaml").touch()
    await fill(pilot, bringup=str(robots / "map.yaml"))
    assert form.values["name"] == "robot1", "a name that was given stays"
    await fill(pilot, path="robot1.yaml", bringup=typed)
    form.fields["name"].control.focus()
    await pilot.press("enter")
    await shown(pilot, "Imported. Run robot1.yaml?")


@on_welcome()
async def test_thesis_file_with_mistake_says_line(app: ConsoleApp, pilot: Pilot[None], folder: Path) -> None:
    (folder / "bringup.yaml").write_text(BRINGUP.format(protocol="UDX"))
    await pilot.press("i", *"bri", "enter")
    await fill(pilot, name="robot1", path="robot1.yaml")
    await pilot.press("enter")
    await shown(pilot, "line 8:")
    await shown(pilot, "(did you mean udp?)")
    assert not (folder / "robot1.yaml").exists()
