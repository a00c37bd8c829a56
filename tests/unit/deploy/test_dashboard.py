"""Grafana's dashboard asks for metrics that the processes export, by labels that these have."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from prometheus_client import REGISTRY

from rodeo.host import metrics as _metrics  # noqa: F401 - declares them
from services.bridge import attachment as _attachment  # noqa: F401
from services.bridge import process as _process  # noqa: F401

DASHBOARD = Path(__file__).parents[3] / "deploy" / "grafana" / "dashboard.json"
SCRAPED = {"process", "instance", "job"}
"""Labels that the console's list of targets and Prometheus add."""
OF_TYPE = {"gauge": ("",), "counter": ("_total",), "histogram": ("_bucket", "_count", "_sum")}
QUERIES = [
    query["expr"] for panel in json.loads(DASHBOARD.read_text())["panels"] for query in panel["targets"]
]


def exported() -> dict[str, Any]:
    """Name of a sample -> the labels that it has."""
    collectors = REGISTRY._collector_to_names
    labels = {
        name: set(getattr(one, "_labelnames", ())) for one, names in collectors.items() for name in names
    }
    return {"up": set()} | {
        family.name + end: labels[family.name] | ({"le"} if end == "_bucket" else set())
        for family in REGISTRY.collect()
        for end in OF_TYPE.get(family.type, ())
    }


@pytest.mark.parametrize("query", QUERIES)
def test_each_query_names_metrics_that_are_exported_and_their_labels(query: str) -> None:
    names = re.findall(r"\b(?:(?:rodeo|process)_\w+|up\b)", query)
    labels = {one.strip() for found in re.findall(r"by \(([^)]*)\)", query) for one in found.split(",")}
    labels |= set(re.findall(r"[{,](\w+)=", query))
    assert names
    for name in names:
        assert labels <= exported()[name] | SCRAPED, name
