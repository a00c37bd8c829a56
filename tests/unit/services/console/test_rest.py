"""What programs are told of their requests."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.testclient import TestClient

from rodeo.access.accounts import User
from rodeo.bus.messages import Status
from rodeo.bus.session import validate
from rodeo.commands.tasks import RegisterTask
from rodeo.errors import InvalidRequest
from rodeo.site import topics
from services.console.heartbeats import Heartbeats
from services.console.rest import make_api
from tests.support.site import RunningSite, write_site

LIVE = SimpleNamespace(heartbeats=None)


@pytest.fixture
def client() -> TestClient:
    accounts = SimpleNamespace(token_user=lambda _token: User("ada", frozenset(), None, False))
    console: Any = SimpleNamespace(accounts=accounts, queries=None, live=LIVE)
    return TestClient(make_api(console), headers={"Authorization": "Bearer x"})


@pytest.mark.parametrize(
    ("body", "fields"),
    [
        ({"reward_iec": "1"}, {"body.kind": "is missing: write it"}),
        ({"kind": "a", "reward_iec": "much"}, {"body.reward_iec": 'write a number in IEC, not "much"'}),
        ({"kind": "a", "reward_iec": "-1"}, {"body.reward_iec": 'write at least 0 IEC, not "-1"'}),
        ({"kind": "a", "reward_iec": "1", "params": 7}, {"body.params": "write a table in { }"}),
        ({"kind": "a", "reward_iec": "1", "prams": {}}, {"body.prams": "no such field"}),
    ],
)
def test_a_wrong_field_is_named_in_plain_words(
    client: TestClient, body: dict[str, Any], fields: dict[str, str]
) -> None:
    answer = client.post("/actions/post-task", json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")
    assert answer.json()["details"]["fields"] == fields


def test_a_wrong_question_is_named_in_plain_words(client: TestClient) -> None:
    answer = client.get("/tasks", params={"limit": 1000, "state": "opne"})
    fields = answer.json()["details"]["fields"]
    assert fields["query.limit"] == 'write at most 500, not "1000"'
    assert fields["query.state"].endswith('not "opne"; is "open" meant?')


def test_the_bus_says_the_same(client: TestClient) -> None:
    with pytest.raises(InvalidRequest) as caught:
        validate(RegisterTask, {"reward_iec": "1", "kinds": "waste_disposal"})
    assert caught.value.details["fields"] == {
        "kind": "is missing: write it",
        "kinds": 'no such field; is "kind" meant?',
    }


def test_prometheus_is_told_where_the_sites_own_processes_serve_their_metrics(
    client: TestClient, tmp_path: Path
) -> None:
    heartbeats = Heartbeats(RunningSite(write_site(tmp_path), wallets=False).site)
    for name, url in (
        ("bridge", "http://127.0.0.1:9001"),
        ("oracle", "http://127.0.0.1:9002/else?x="),
        ("stranger", "http://127.0.0.1:9003"),
    ):
        said = Status(
            process=name, pid=1, ready=True, reason="", activity="", progress=None, since_s=0, time_s=0,
            metrics_url=url,
        )  # fmt: skip
        heartbeats.hear(topics.STATUS.name(org="lab", process=name), said.model_dump())
    LIVE.heartbeats = heartbeats
    answer = client.get("/metrics-targets").json()
    assert answer == [{"targets": ["127.0.0.1:9001"], "labels": {"process": "bridge"}}]
