"""Answers become messages, and requests what the models take."""

from __future__ import annotations

import json
from decimal import Decimal
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent, Task
from rodeo.bus.session import validate
from rodeo.commands.services import UpdateService
from rodeo.commands.tasks import RegisterTask
from rodeo.errors import InvalidRequest, RodeoError
from rodeo.interfaces.convert import message, params_message, problem, request_of
from rodeo.interfaces.package import asked, commands, register
from rodeo.money.currency import IEC, Currency
from rodeo.payloads import EXAMPLES
from rodeo.ros2 import types

PLACE = {"item_id": "item1", "x_m": 1.5, "y_m": 2.0}


@pytest.fixture(scope="module", autouse=True)
def registered() -> None:
    register()


def over_the_wire(sent: Any) -> Any:
    return types.deserialize(types.serialize(sent), sent.__msgtype__)


def request(service: str, **fields: Any) -> dict[str, Any]:
    known = commands().get(service) or asked()[service]
    sent = over_the_wire(types.new(f"{known.interface.typename}_Request", **fields))
    return request_of(known.request, sent, IEC)


def typed_params(**fields: Any) -> Any:
    return types.new("rodeo_msgs/msg/TaskParams", **fields)


def test_a_task_arrives_with_its_amounts_times_and_what_is_unset() -> None:
    task = Task.model_validate(
        EXAMPLES[Task]
        | {
            "kind": "waste_disposal",
            "params": PLACE,
            "reward_iec": "100.5",
            "price_iec": None,
            "assigned": None,
        }
    )
    got = over_the_wire(message(task, IEC))
    assert (got.id, got.state, got.reward_iec, got.reward_wei) == (
        task.id,
        task.state,
        "100.5",
        "100500000000000000000",
    )
    assert list(got.price_iec) == list(got.price_wei) == list(got.assigned) == []
    assert got.registered.sec + got.registered.nanosec * 1e-9 == pytest.approx(task.registered, abs=1e-6)
    assert json.loads(got.params.json) == PLACE
    (place,) = got.params.waste_disposal
    assert (place.item_id, place.x_m, place.y_m, list(place.bin)) == ("item1", 1.5, 2.0, [])
    assert not len(got.params.battery_charging)


def test_an_amount_of_another_token_is_in_that_tokens_unit() -> None:
    task = Task.model_validate(EXAMPLES[Task] | {"reward_iec": "1.25"})
    assert message(task, Currency(6)).reward_wei == "1250000"


def test_an_event_is_one_message_with_its_arguments_as_json() -> None:
    event = DaoEvent.model_validate(EXAMPLES[DaoEvent])
    got = over_the_wire(message(event, IEC))
    assert (got.seq, got.name, got.block, got.log_index) == (
        event.seq,
        event.name,
        event.block,
        event.log_index,
    )
    assert json.loads(got.args) == event.args
    assert got.task_id.tolist() == [event.task_id]


def test_parameters_that_do_not_fit_their_kind_are_json_only() -> None:
    got = params_message("waste_disposal", {"item_id": 7})
    assert json.loads(got.json) == {"item_id": 7} and not got.waste_disposal


@pytest.mark.parametrize(
    "said",
    [
        {"reward_iec": "100"},
        {"reward_wei": "100" + "0" * 18},
        {"reward_iec": "100.0", "reward_wei": "1" + "0" * 20},
    ],
)
def test_an_amount_is_said_in_either_unit(said: dict[str, str]) -> None:
    found = request("register_task", kind="waste_disposal", **said)
    assert validate(RegisterTask, found | {"params": PLACE}).reward_iec == Decimal(100)


@pytest.mark.parametrize(
    "said",
    [
        {"reward_iec": "100", "reward_wei": "1"},
        {"reward_iec": "much"},
        {"reward_wei": "1.5"},
        {"reward_iec": "1e99999999"},
        {"reward_iec": "1e-99999999"},
        {"reward_iec": "1" + "0" * 99},
        {"reward_iec": "inf"},
        {"reward_iec": "sNaN"},
        {"reward_wei": "9" * 99},
    ],
)
def test_amounts_that_do_not_agree_or_are_none_are_refused(said: dict[str, str]) -> None:
    with pytest.raises(InvalidRequest) as caught:
        request("register_task", kind="waste_disposal", **said)
    assert "reward_iec" in caught.value.details["fields"]


def test_an_amount_that_nobody_says_is_missed_by_the_model() -> None:
    with pytest.raises(InvalidRequest) as caught:
        validate(RegisterTask, request("register_task", kind="waste_disposal"))
    assert set(caught.value.details["fields"]) == {"reward_iec"}


def test_typed_parameters_are_those_of_the_kind() -> None:
    place = types.new("rodeo_msgs/msg/WasteDisposalParams", **PLACE)
    found = request("register_task", kind="waste_disposal", params=typed_params(waste_disposal=[place]))
    assert found["params"] == PLACE
    as_json = typed_params(json=json.dumps(PLACE))
    assert request("register_task", kind="waste_disposal", params=as_json)["params"] == PLACE
    for kind, params in (
        ("battery_charging", typed_params(waste_disposal=[place])),
        ("waste_disposal", typed_params(waste_disposal=[place], json="{}")),
        ("waste_disposal", typed_params(json="{")),
        ("waste_disposal", typed_params(json="[" * 3000)),
        ("waste_disposal", typed_params(json='{"a":' * 300 + "1" + "}" * 300)),
        ("waste_disposal", typed_params(json=r'{"a": "\ud800"}')),
        ("waste_disposal", typed_params(json="[]")),
    ):
        with pytest.raises(InvalidRequest):
            request("register_task", kind=kind, params=params)


def test_what_is_unset_has_the_models_default() -> None:
    assert request("update_service", service_id=2) == {"service_id": 2, "dry_run": False}
    update = validate(UpdateService, request("update_service", service_id=2, state=["paused"]))
    assert (update.state, update.price_iec, update.request_id) == ("paused", None, None)
    assert request("get_events", after=31) == {"after": 31}


def test_an_error_keeps_its_code_words_and_details() -> None:
    got = over_the_wire(problem(InvalidRequest("no such field", fields={"a": "b"})))
    assert (got.code, got.message, json.loads(got.details)) == (
        "invalid_request",
        "no such field",
        {"fields": {"a": "b"}},
    )
    assert problem(RodeoError("x")).code == "rodeo_error"


def test_of_what_may_be_unset_a_request_says_one_value_at_most() -> None:
    with pytest.raises(InvalidRequest) as caught:
        request("set_namers", service_id=1, namers=["anybody", "nobody"])
    assert caught.value.details["fields"] == {"namers": "too many"}
