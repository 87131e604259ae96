"""The Grafana dashboard and the alert rules that ship with the project ask for nothing that a bridge does not tell."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.captured import captured

from rsb_bridge.model.snapshot import Level, State
from rsb_extras.exporters.metrics import DROPPED, FAMILIES

_CONFIGS = Path(__file__).parents[4] / "configs"
_RULES = _CONFIGS / "prometheus-alerts.yml"
_OF_PROMETHEUS = {"instance", "job"}
_OF_PROCESSES = {"process_cpu_seconds_total", "process_resident_memory_bytes", "up"}
_VALUES = {
    "state": {state.value for state in State},
    "level": {level.value for level in Level},
    "cause": DROPPED,
    "percentile": {"50", "99"},
}
LABELS = {family.name: set(family.labels) for family in FAMILIES} | {name: set() for name in _OF_PROCESSES}
_SELECTOR = re.compile(r"\b([a-z]\w*_\w+|up)\b(?:\{([^}]*)\})?(?!\w*\()")
_MATCHER = re.compile(r'(\w+)\s*(=~|!~|!=|=)\s*"([^"]*)"')


def rules() -> list[dict[str, Any]]:
    groups = yaml.safe_load(_RULES.read_text(encoding="utf-8"))["groups"]
    return [rule for group in groups for rule in group["rules"]]


def dashboard() -> dict[str, Any]:
    board: dict[str, Any] = json.loads((_CONFIGS / "grafana-dashboard.json").read_text(encoding="utf-8"))
    return board


def queries() -> Iterator[str]:
    yield from (rule["expr"] for rule in rules())
    for panel in dashboard()["panels"]:
        yield from (target["expr"] for target in panel.get("targets", ()))
    for variable in dashboard()["templating"]["list"]:
        if variable["type"] == "query":
            yield variable["query"]["query"].removeprefix("label_values")


@pytest.mark.parametrize("query", list(queries()))
def test_query_names_existing_metrics_labels_and_values(query: str) -> None:
    found = [match for match in _SELECTOR.finditer(query) if match[1] not in ("label_values", "$__rate_interval")]
    named = [match for match in found if not match[1].startswith("__") and match[1] != "__rate_interval"]
    assert named
    for name, matchers in (match.groups() for match in named):
        assert name in LABELS
        for label, _, value in _MATCHER.findall(matchers or ""):
            assert label in LABELS[name] | _OF_PROMETHEUS
            if label in _VALUES:
                assert set(value.split("|")) <= _VALUES[label]
    for labels in re.findall(r"\b(?:by|without|on) \(([^)]*)\)", query):
        assert set(labels.split(", ")) <= set.union(_OF_PROMETHEUS, *(LABELS[match[1]] for match in named))
    for left, right in ("()", "[]", "{}"):
        assert query.count(left) == query.count(right)
    assert query.count('"') % 2 == 0


def test_a_counter_is_never_shown_as_it_is() -> None:
    for query in queries():
        for counter in re.findall(r"(.{0,10})\b\w+_total\b", query):
            assert re.search(r"(rate|increase)\($", counter), query


def test_alerts_name_only_labels_that_their_metrics_have() -> None:
    assert len({rule["alert"] for rule in rules()}) == len(rules())
    for rule in rules():
        names = {match[1] for match in _SELECTOR.finditer(rule["expr"])}
        known = set.union(_OF_PROMETHEUS, *(LABELS[name] for name in names))
        shown = set(re.findall(r"\$labels\.(\w+)", " ".join(rule["annotations"].values())))
        assert shown <= known, rule["alert"]
        assert rule["labels"]["severity"] in ("critical", "warning")


def test_panels_overlap_nowhere() -> None:
    taken: set[tuple[int, int]] = set()
    panels = dashboard()["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    for panel in panels:
        at = panel["gridPos"]
        cells = {(x, y) for x in range(at["x"], at["x"] + at["w"]) for y in range(at["y"], at["y"] + at["h"])}
        assert taken.isdisjoint(cells)
        assert at["x"] + at["w"] <= 24
        taken |= cells
        for target in panel.get("targets", ()):
            names = {match[1] for match in _SELECTOR.finditer(target["expr"])} & LABELS.keys()
            known = set.union(_OF_PROMETHEUS, *(LABELS[name] for name in names))
            assert set(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])) <= known


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed")
def test_prometheus_takes_the_rules() -> None:
    run = captured("promtool", "check", "rules", _RULES)
    assert run.returncode == 0, run.stdout + run.stderr
