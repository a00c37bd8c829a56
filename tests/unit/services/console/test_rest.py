"""What programs are told of their requests."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from starlette.testclient import TestClient

from rodeo.access.accounts import User
from rodeo.bus.session import validate
from rodeo.commands.tasks import RegisterTask
from rodeo.errors import InvalidRequest
from services.console.rest import make_api


@pytest.fixture
def client() -> TestClient:
    accounts = SimpleNamespace(token_user=lambda _token: User("ada", frozenset(), None, False))
    console: Any = SimpleNamespace(accounts=accounts, queries=None)
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
