"""The table of figures: each can be read from every snapshot of its subject."""

from __future__ import annotations

from dataclasses import replace

from tests.console.scripted import CALLS, LINK, route

from rsb_bridge.model.figure_table import FIGURES, Of, Unit

SCAN = route("/scan")
SUBJECTS = {
    Of.LINK: replace(LINK, association_ends=60.0),
    Of.ROUTE: SCAN,
    Of.MESSAGES: SCAN,
    Of.CALLS: route("/dock", calls=CALLS),
}


def test_every_figure_can_be_read() -> None:
    for each in FIGURES:
        value = each.read(SUBJECTS[each.of])
        if each.unit is not Unit.NONE:
            assert isinstance(value, float), each.name


def test_figures_of_one_metric_differ_by_labels() -> None:
    for metric in {(each.of, each.metric) for each in FIGURES if each.metric}:
        alike = [each for each in FIGURES if (each.of, each.metric) == metric]
        assert len({each.at for each in alike}) == len(alike)
        assert [bool(each.help) for each in alike] == [True] + [False] * (len(alike) - 1)
