"""The exporters' keys of a session file: their mistakes, advice on them, and what a saved file has of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.config.mistakes import CLIENT, SERVER, problems
from tests.console.scripted import SESSION
from tests.support.commands import Ran, rsb_console
from tests.support.wording import says

from rsb_bridge.config.advice import Advice, advise
from rsb_bridge.config.decoding import ValueMistake
from rsb_bridge.config.file_form import with_types
from rsb_bridge.config.name_rules import NameMistake
from rsb_bridge.config.session_file import dump, load_file, parse, save
from rsb_bridge.config.validation import SessionMistake, validate
from rsb_bridge.model.session import Session
from rsb_bridge.model.text import is_clean
from rsb_extras.exporters.rules import AddressProblem, ExporterText

if TYPE_CHECKING:
    from rsb_bridge.model.wording import Wording


def replace(session: Session, **features: object) -> Session:
    return msgspec.structs.replace(session, features=features)


@pytest.mark.parametrize(
    ("text", "place", "code", "parameters"),
    [
        *(
            (
                CLIENT + f"driver_topic: {name}\n{keys}",
                "6 driver_topic",
                ExporterText.DRIVER_TOPIC_TAKEN,
                {"name": name, "use": use},
            )
            for name, keys, use in (
                ("/cmd_vel", "topics: [{topic: /cmd_vel, direction: receive, arm: true}]\n", "bridged"),
                ("/cmd_vel", "armed: [/cmd_vel]\n", "to be armed"),
                ("/cmd_vel", "armed: [{name: /cmd_vel}]\n", "to be armed"),
                ("/diagnostics", "", "the diagnostics_topic"),
                ("/shutdown", "", "the shutdown_topic"),
            )
        ),
        (SERVER + "use_name: true\ndriver_topic: /robot1/cmd_vel\n"
         "clients: [{name: robot1, topics: [{topic: /cmd_vel, direction: receive}]}]\n", "7 driver_topic",
         ExporterText.DRIVER_TOPIC_TAKEN, {"name": "/robot1/cmd_vel", "use": "bridged"}),
        (CLIENT + "metrics: 9464\n", "6 metrics", ValueMistake.MISFIT, {"value": 9464, "expected": "text"}),
        (CLIENT + "metrics: '9464'\n", "6 metrics", AddressProblem.NOT_ADDRESS_AND_PORT, {"address": "9464"}),
        (CLIENT + "metrics: ':9464'\n", "6 metrics", AddressProblem.NO_ADDRESS, {"address": ":9464", "port": 9464}),
        (CLIENT + "metrics: ::1:9464\n", "6 metrics", AddressProblem.NO_BRACKETS, {"address": "::1:9464"}),
        (CLIENT + "metrics: 127.0.0.1:0\n", "6 metrics", AddressProblem.INVALID_PORT, {"port": "0"}),
        (CLIENT + "metrics: a b:9464\n", "6 metrics", ExporterText.METRICS_HOST_INVALID, {"host": "'a b'"}),
        (CLIENT + "metrics: '[fe80::1]:9464'\n", "6 metrics", SessionMistake.ZONE_MISSING, {}),
        (CLIENT + "diagnostics_topic: /a/*\n", "6 diagnostics_topic", None, {}),
        (CLIENT + "driver_topic: /a/*\n", "6 driver_topic", None, {}),
        (CLIENT + "diagnostics_topic: health\n", "6 diagnostics_topic", NameMistake.NOT_ABSOLUTE, {}),
    ],
)  # fmt: skip
def test_a_mistake_has_its_line(text: str, place: str, code: Wording | None, parameters: dict[str, Any]) -> None:
    (problem,) = problems(text)
    assert f"{problem.line} {problem.location}" == place
    assert code is None or says(problem.message, code, **parameters)


def test_metrics_for_every_network_are_warned_of() -> None:
    session = replace(SESSION, metrics="0.0.0.0:9464")
    assert validate(session) == []
    assert [each.message for each in advise(session, None) if each.location == "metrics"] == [
        ExporterText.METRICS_OPEN()
    ]


def test_metrics_at_an_absent_interface_are_named() -> None:
    found = advise(replace(SESSION, metrics="[fe80::1%nope]:9464"), None)
    assert [each.location for each in found if says(each.message, Advice.NO_INTERFACE, zone="nope")] == ["metrics"]


values = st.fixed_dictionaries(
    {},
    optional={
        "diagnostics_topic": st.sampled_from([None, "/health"]),
        "driver_topic": st.just("/rsb/driver"),
        "metrics": st.sampled_from(["127.0.0.1:9464", "[::1]:9464", "robot-1.local:65535"]),
        "on_fault": st.sampled_from(["./tell.sh --loud", ("./tell.sh", "the operator")]),
    },
)


@given(values)
def test_session_with_these_keys_is_loaded_as_saved(features: dict[str, Any]) -> None:
    session = replace(SESSION, **features)
    assert validate(session) == []
    assert parse(dump(session), Path("robot1.yaml")) == session


def test_attached_console_gets_these_keys_in_their_types() -> None:
    session = replace(SESSION, on_fault=("./tell.sh", "the operator"), metrics="[::1]:9464")
    plain = msgspec.msgpack.decode(msgspec.msgpack.encode(session), type=Session)
    assert plain != session, "a tuple came as a list"
    assert with_types(plain) == session
    with pytest.raises(msgspec.ValidationError):
        with_types(replace(SESSION, metrics=7))


def test_patterns_leave_out_the_topic_of_drivers() -> None:
    assert SESSION.own_topics == ("/shutdown", None)
    assert replace(SESSION, driver_topic="/held").own_topics == ("/shutdown", "/held")


@pytest.mark.parametrize("after", [{}, {"metrics": "[::1]:9464"}, {"driver_topic": "/rsb/driver", "on_fault": "./a"}])
def test_a_saved_change_leaves_the_other_lines(tmp_path: Path, after: dict[str, Any]) -> None:
    path = tmp_path / "robot1.yaml"
    lines = f"{dump(SESSION)}metrics: 127.0.0.1:9464 # ours\n"
    path.write_text(lines)
    opened = load_file(path)
    save(replace(opened.session, **after), path, opened)
    assert load_file(path).session.features == after
    assert set(dump(SESSION).splitlines()) <= set(path.read_text().splitlines())


def test_check_cleans_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(dump(SESSION) + r'''on_fault: "/\e]0;evil\a\e[2J\u202e\x9b31m\nforged: line\r x"''' + "\n")
    done = Ran(capsys, "check", str(path))
    assert "evil" in done.out + done.err
    assert is_clean((done.out + done.err).replace("\n", ""))


def test_check_names_command_and_warns_unless_it_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rsb_console("keygen")
    path, program = Path("robot1.yaml"), Path("tell.sh")
    path.write_text(dump(msgspec.structs.replace(SESSION, key_file="key.txt")) + "on_fault: ./tell.sh --loud\n")
    path.chmod(0o600)
    missing = rsb_console("check", "robot1.yaml")
    assert missing.returncode == 0, "the bridge runs without it"
    assert [line.startswith("warning") for line in missing.stdout.splitlines() if "./tell.sh" in line] == [False, True]
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    assert "tell.sh" not in [
        line for line in rsb_console("check", "robot1.yaml").stdout.splitlines() if line.startswith("warning")
    ]
