"""Measurements as tables, as plots and as JSON."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import msgspec
import pytest

from rsb_extras.bench.presentation import as_svg, in_terminal, lines_of
from rsb_extras.bench.results import BenchReport, as_json
from rsb_extras.bench.suite import QUICK, Suite
from rsb_extras.bench.tests.simulated import SimulatedLink, SimulatedPlace

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def report() -> BenchReport:
    place = SimulatedPlace({"tcp": SimulatedLink(), "udp": SimulatedLink(50e6)})
    made = BenchReport('This <link> & its "peer"', "a machine")
    Suite(place, QUICK, made, lambda: place.time, lambda _: None).run()
    made.judged, made.verdict = [], ["It carries everything."]
    return made


@pytest.mark.parametrize("width", [20, 80, 200])
def test_plot_keeps_to_width_and_plain_characters(report: BenchReport, width: int) -> None:
    lines = in_terminal(report.points, width)
    assert all(len(line) <= max(width, 66) for line in lines)
    assert all(line.isascii() for line in lines)
    assert "tcp" in lines[-1]
    assert "udp" in lines[-1]


def test_svg_is_well_formed_with_line_per_transport(report: BenchReport) -> None:
    root = ET.fromstring(as_svg(report.points, report.over))
    assert root.tag == f"{SVG}svg"
    assert len(root.findall(f"{SVG}polyline")) == 2
    assert len(root.findall(f"{SVG}circle")) == len(report.points)
    assert root.findtext(f"{SVG}title") == report.over


def test_without_figures_svg_is_well_formed_without_plot() -> None:
    assert ET.fromstring(as_svg([], "nothing")) is not None
    assert in_terminal([], 80) == []


def test_the_json_is_what_its_schema_says(report: BenchReport) -> None:
    text = as_json(report)
    assert "\n" not in text
    assert msgspec.json.decode(text, type=BenchReport) == report
    plain = msgspec.json.decode(text)
    assert plain["version"] == 1
    keys = {"transport", "direction", "size", "gentle", "base", "best", "limit", "full", "paced"}
    assert keys == set(plain["points"][0])
    msgspec.json.schema(BenchReport)


def test_the_tables_have_a_row_for_each_size(report: BenchReport) -> None:
    text = "\n".join(lines_of(report))
    assert text.count("\ntcp") >= 2 * len(QUICK.sizes)
    assert report.machine in text
    assert all(line == line.rstrip() for line in text.splitlines())
