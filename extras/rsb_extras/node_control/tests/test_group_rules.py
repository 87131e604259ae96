"""Groups and the right to change nodes in session files: their mistakes, and what `check` says."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from rsb_bridge.config.rights import rights_of_client, rights_of_server
from rsb_bridge.config.session_file import SessionError, dump, load
from rsb_bridge.config.validation import build
from rsb_extras.node_control import FEATURE, GROUPS, MAY_CHANGE
from rsb_extras.node_control.change_records import MOST_GROUPS, MOST_OF_GROUP

if TYPE_CHECKING:
    from pathlib import Path

ROBOT: dict[str, Any] = {
    "name": "robot1", "role": "client", "server_ip": "10.0.0.20", "server_port": 49152, "key_file": "r.key"
}  # fmt: skip
FILE = "name: robot1\nrole: client\nserver_ip: 10.0.0.20\nserver_port: 7060\nkey_file: r.key\n"


def mistakes(**given: Any) -> dict[str, str]:
    return {problem.location: problem.message for problem in build({**ROBOT, **given})[1]}


def test_groups_are_read_from_a_file_and_written_again(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(f"{FILE}groups:\n  nav: [/controller_server, /planner_server]\nmay: {{nodes: [nav, /lidar]}}\n")
    session = load(path)
    assert GROUPS.of(session) == {"nav": ("/controller_server", "/planner_server")}
    assert MAY_CHANGE.of(rights_of_server(session)) == ("nav", "/lidar")
    again = tmp_path / "again.yaml"
    again.write_text(dump(session))
    assert load(again) == session


def test_mistakes_name_their_line(tmp_path: Path) -> None:
    path = tmp_path / "robot1.yaml"
    path.write_text(f"{FILE}groups:\n  nav:\n    - /a\n    - b\n  lidar: /c\n")
    with pytest.raises(SessionError) as raised:
        load(path)
    assert f"{path}:9: groups.nav[1]: 'b' is not an absolute node name" in str(raised.value)
    assert f"{path}:10: groups.lidar: '/c' is not a list" in str(raised.value)


@pytest.mark.parametrize(
    ("groups", "place"),
    [
        ({"a/b": ["/n"]}, "groups.a/b"),
        ({"": ["/n"]}, "groups."),
        ({"x" * 64: ["/n"]}, f"groups.{'x' * 64}"),
        ({"nav": []}, "groups.nav"),
        ({"nav": ["/n", "/m", "/n"]}, "groups.nav[2]"),
        ({"nav": ["/n*"]}, "groups.nav[0]"),
        ({"nav": [1]}, "groups.nav[0]"),
        ({"nav": [f"/n{number}" for number in range(MOST_OF_GROUP + 1)]}, "groups.nav"),
        ({f"g{number}": ["/n"] for number in range(MOST_GROUPS + 1)}, "groups"),
        (["nav"], "groups"),
    ],
)
def test_a_mistake_is_found_at_its_place(groups: Any, place: str) -> None:
    assert place in mistakes(groups=groups)


def test_may_names_groups_of_this_session_and_any_node() -> None:
    groups = {"nav": ["/planner"]}
    assert mistakes(groups=groups, may={"nodes": ["nav", "/lidar"]}) == {}
    assert "may.nodes[1]" in mistakes(groups=groups, may={"nodes": ["nav", "lidar"]})
    assert "may.nodes[0]" in mistakes(may={"nodes": ["/lidar/"]})
    assert "may.nodes" in mistakes(may={"nodes": "nav"})


def test_a_server_gives_the_right_to_each_client() -> None:
    clients = [{"name": "robot1", "key_file": "a", "may": {"nodes": ["/n"]}}, {"name": "robot2", "key_file": "b"}]
    session, problems = build({**ROBOT, "name": "pc", "role": "server", "clients": clients})
    assert not problems
    assert [MAY_CHANGE.of(rights_of_client(each, "pc")) for each in session.listed_clients] == [("/n",), ()]


def test_check_says_who_may_change_what() -> None:
    session, problems = build({**ROBOT, "groups": {"nav": ["/a", "/b"]}, "may": {"nodes": ["nav"]}})
    assert not problems
    assert list(FEATURE.effects(session)) == [
        "group nav: up configures and activates /a, /b, one after the other; down goes back in reverse",
        "the server may change states and parameters of: nav",
    ]
