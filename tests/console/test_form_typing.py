"""Typing into forms: on coming to a field, and faster than a refusal shows."""

import pytest
from tests.console.driving import fill, form_of, on_welcome, send, shown, text, until
from textual.events import Key
from textual.pilot import Pilot

from rsb_console.app import ConsoleApp
from rsb_console.widgets.controls import FieldInput

pytestmark = pytest.mark.usefixtures("folder")


@on_welcome()
async def test_typing_replaces_field_but_lengthens_path(app: ConsoleApp, pilot: Pilot[None]) -> None:
    await pilot.press("n")
    await shown(pilot, "Session file")
    form = form_of(app)
    for key, typed in (("server_port", "3"), ("path", "robot.yaml3"), ("name", "3")):
        await fill(pilot, name="robot", path="robot.yaml")
        control = form.fields[key].control
        assert isinstance(control, FieldInput)
        control.cursor_position = 1  # where it was left
        for each in (form.fields["role"].control, control):
            each.focus()
            await until(pilot, lambda e=each: e.has_focus, "the focus")
        assert control.selection.is_empty is (key == "path")
        await pilot.press("3")
        assert control.value == typed


def type_at_once(app: ConsoleApp, *keys: str) -> None:
    """Type faster than the console looks."""
    send(app, *(Key(key, key if len(key) == 1 else None) for key in keys))


@pytest.mark.parametrize("pressed", ["server_port", "use_encryption", "#yes"])
@on_welcome()
async def test_typing_between_create_and_refusal_is_dropped(
    app: ConsoleApp, pilot: Pilot[None], pressed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    await pilot.press("n")
    await shown(pilot, "Session file")
    await fill(pilot, name="robot1", server_ip="10.0.0.20", domain_id="")
    form = form_of(app)
    control = form.fields[pressed].control if pressed in form.fields else app.screen.query_one(pressed)
    control.focus()
    await until(pilot, lambda: control.has_focus, "the focus")
    form.fields["domain_id"].value = "233"  # the refusal's reason
    before = form.values
    settle = form.settle

    def settle_and_type() -> bool:
        fine = settle()
        type_at_once(app, "y", "backspace")
        return fine

    listening_at: list[str] = []

    def listen() -> None:
        end()
        listening_at.append(text(app))

    end = form.input_guard.end
    monkeypatch.setattr(form.input_guard, "end", listen)
    monkeypatch.setattr(form, "settle", settle_and_type)
    type_at_once(app, "enter", "x", "backspace", "h", "z")
    await shown(pilot, "0 to 232")
    await until(pilot, lambda: form.fields["domain_id"].control.has_focus, "the focus on what is wrong")
    assert form.values == before
    await until(pilot, lambda: listening_at, "a form that listens again")
    assert "0 to 232" in listening_at[0], "not before the refusal is to be seen"
    await fill(pilot, domain_id="3")
    await pilot.press("4")
    assert form.values["domain_id"] == "34"
