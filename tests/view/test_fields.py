"""All fields of any message, as a tree."""

from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import LaserScan
from tests.view.samples import drawn, task

from rsb_bridge.model.pictures import Cells, Wish
from rsb_bridge.view.worker import Artist


def test_fields_and_values_are_shown() -> None:
    message = PoseStamped()
    message.header.frame_id = "map"
    message.pose.position.x = 1.5
    content = drawn(Wish(width=40, height=20, how="tree"), message).content
    assert isinstance(content, Cells)
    text = "\n".join(content.rows)
    assert "frame_id: map" in text
    assert "x: 1.5" in text


def test_changed_values_are_marked() -> None:
    artist, message = Artist(), PoseStamped()
    wish = Wish(width=40, height=20, how="tree")
    artist.do(task(wish, message))
    message.pose.position.y = 2.0
    picture = artist.do(task(wish, message))
    assert picture is not None
    assert isinstance(picture.content, Cells)
    rows, styles, at = picture.content.rows, picture.content.styles, 0
    strong = picture.content.palette.index("strong")
    for row in rows:
        marked = strong in styles[at : at + len(row)]
        assert marked == row.strip().startswith("y: 2")
        at += len(row)


def test_long_arrays_are_cut() -> None:
    content = drawn(Wish(width=100, height=20, how="tree"), LaserScan(ranges=[1.0] * 720)).content
    assert isinstance(content, Cells)
    assert any("720 × float32" in row for row in content.rows)
