"""`rodeo_msgs`: names, fields, hashes and grammar of what is generated."""

from __future__ import annotations

import hashlib
import json
import subprocess
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from rodeo import kinds
from rodeo.bus import queries
from rodeo.bus.messages import Instant, TaskParams
from rodeo.commands import COMMANDS
from rodeo.interfaces import package
from rodeo.interfaces.fields import NoInterface, fields_of
from rodeo.interfaces.generate import ROOT, files, stale
from rodeo.interfaces.naming import NameCollision, distinct, field_name, interface_name, service_name
from rodeo.interfaces.package import interfaces, register
from rodeo.ros2 import definitions, types
from rodeo.ros2.definitions import ARRAY, BASE, NAME, SEQUENCE, definition

pytestmark = pytest.mark.long

# Hashes that rosidl generated for ROS 2 Jazzy (tests/unit/ros2/test_types.py has their sources). The events
# of services hold bounded sequences, as all that may be unset is.
PUBLISHED = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_srvs/srv/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "action_msgs/srv/CancelGoal": "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
}

TYPE_IDS = {"int8": 2, "uint8": 3, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9, "float32": 10,
            "float64": 11, "bool": 15, "byte": 16, "string": 17}  # fmt: skip
"""type_description_interfaces/msg/FieldType."""


def rihs01(typename: str) -> str:
    """REP-2016, written again: the hash of a type's description and of all that it refers to."""
    referred: dict[str, Any] = {}

    def field_type(descriptor: Any) -> dict[str, Any]:
        kind, detail = descriptor
        if kind == NAME:
            described(detail)
            return {"type_id": 1, "capacity": 0, "string_capacity": 0, "nested_type_name": detail}
        if kind == BASE:
            name, limit = detail
            return {
                "type_id": TYPE_IDS[name],
                "capacity": 0,
                "string_capacity": limit,
                "nested_type_name": "",
            }
        assert kind in (ARRAY, SEQUENCE)
        element, bound = detail
        one = field_type(element)
        one["type_id"] += 48 if kind == ARRAY else 96 if bound else 144
        return one | {"capacity": bound}

    def described(name: str) -> dict[str, Any]:
        if name not in referred:
            referred[name] = {}
            fields = [{"name": field, "type": field_type(d)} for field, d in definition(name).fields]
            referred[name] = {"type_name": name, "fields": fields}
        return referred[name]

    main = described(typename)
    others = [referred[name] for name in sorted(referred) if name != typename]
    text = json.dumps({"type_description": main, "referenced_type_descriptions": others})
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.fixture(scope="module", autouse=True)
def registered() -> None:
    register()


@pytest.mark.parametrize(("typename", "digest"), PUBLISHED.items())
def test_the_hashes_of_ros_are_computed_a_second_time(typename: str, digest: str) -> None:
    assert rihs01(typename) == digest


PARTS = ("SendGoal", "GetResult", "FeedbackMessage")
"""What is on the wire of an action."""


def test_every_type_has_the_hash_of_its_description() -> None:
    for one in interfaces():
        ends = [f"_{part}" for part in PARTS] if one.form == "action" else [""]
        for typename in (f"{one.typename}{end}" for end in ends):
            assert definitions.type_hash(typename) == f"RIHS01_{rihs01(typename)}", one.path


@pytest.mark.parametrize(
    "name", ["msg/Tasks", "srv/RegisterTask_Request", "srv/GetEvents_Response", "action/DoTask_Goal"]
)
def test_structures_survive_cdr(name: str) -> None:
    typename = f"rodeo_msgs/{name}"
    cdr = types.serialize(types.new(typename))
    assert types.serialize(types.deserialize(cdr, typename)) == cdr


def test_the_package_is_what_the_tables_say() -> None:
    assert stale() == []


def test_a_file_that_nothing_makes_any_more_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("rodeo.interfaces.generate.ROOT", tmp_path)
    for path, text in files().items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    assert stale() == []
    (tmp_path / "rodeo_msgs/srv/Gone.srv").write_text("")
    (tmp_path / "rodeo_msgs/msg/Task.msg").write_text("int64 id\n")
    assert stale() == ["rodeo_msgs/msg/Task.msg", "rodeo_msgs/srv/Gone.srv"]


def test_every_command_that_a_participant_may_give_is_a_service() -> None:
    wanted = {name for name, model in COMMANDS.items() if "ros_dao" in model.declared.senders}
    assert {one.name for one in package.commands().values()} == wanted
    assert {
        "register_task",
        "update_service",
        "submit_proof",
        "rule",
        "transfer",
        "cast_vote",
        "challenge",
    } <= (wanted)
    administrators = {name for name, model in COMMANDS.items() if model.declared.of_administrator}
    assert not wanted & administrators


def test_every_query_is_a_service() -> None:
    assert {one.query.what for one in package.asked().values()} == {*queries.QUERIES, "kind_schema"}


def declared(name: str, part: int = 0) -> dict[str, str]:
    """Field -> type of a file of the package."""
    (text,) = [one.text() for one in interfaces() if one.path == name]
    lines = [
        line.split(" ", 1) for line in text.split("---\n")[part].splitlines() if "=" not in line.split(" ")[1]
    ]
    return {field: kind for kind, field in lines}


def test_the_request_of_a_new_task_has_its_fields() -> None:
    fields = declared("srv/RegisterTask.srv")
    assert fields["reward_iec"] == fields["reward_wei"] == "string"
    assert fields["params"] == "rodeo_msgs/TaskParams"
    assert fields["service_id"] == "int64[<=1]"
    assert fields["allow_wait"] == "bool"
    assert declared("srv/RegisterTask.srv", 1)["problem"] == "rodeo_msgs/Problem[<=1]"


def test_a_task_has_times_typed_parameters_and_what_is_unset() -> None:
    fields = declared("msg/Task.msg")
    assert fields["registered"] == "builtin_interfaces/Time"
    assert fields["assigned"] == "builtin_interfaces/Time[<=1]"
    assert fields["price_wei"] == "string[<=1]"
    assert fields["passed"] == "rodeo_msgs/Passed[]"
    assert declared("msg/TaskParams.msg") == {
        "json": "string",
        "battery_charging": "rodeo_msgs/BatteryChargingParams[<=1]",
        "waste_disposal": "rodeo_msgs/WasteDisposalParams[<=1]",
    }
    assert declared("msg/WasteDisposalParams.msg") == {
        "item_id": "string",
        "x_m": "float64",
        "y_m": "float64",
        "bin": "string[<=1]",
        "photo": "string[<=1]",
    }


def test_an_installed_kind_of_somebody_else_changes_no_type(monkeypatch: pytest.MonkeyPatch) -> None:
    class Point:
        dist = type("Dist", (), {"name": "somebody-elses"})

    monkeypatch.setattr(kinds, "installed", lambda: {"lawn_mowing": Point()})
    assert package.kind_models.__wrapped__() == {}


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("reward_iec", "reward_iec"),
        ("class", "class_value"),
        ("import", "import_value"),
        ("namespace", "namespace_value"),
        ("Two  Words", "two_words"),
        ("trailing_", "trailing"),
    ],
)
def test_a_name_that_ros_refuses_is_changed_by_one_rule(name: str, field: str) -> None:
    assert field_name(name) == field


@pytest.mark.parametrize("name", ["", "7days", "__", "ö"])
def test_a_name_that_cannot_be_changed_is_refused(name: str) -> None:
    with pytest.raises(NameCollision):
        field_name(name)


class Twice(BaseModel):
    namespace: str
    namespace_value: str


class AmountAndWei(BaseModel):
    price_iec: Decimal
    price_wei: str


class Either(BaseModel):
    what: int | str


class ListOfMaybe(BaseModel):
    what: list[int] | None


@pytest.mark.parametrize("model", [Twice, AmountAndWei])
def test_names_that_become_the_same_are_refused(model: type[BaseModel]) -> None:
    with pytest.raises(NameCollision):
        fields_of(model, request=False)


def test_names_differ_in_more_than_their_case() -> None:
    with pytest.raises(NameCollision):
        distinct(["Task", "task"], "rodeo_msgs")


@pytest.mark.parametrize("model", [Either, ListOfMaybe])
def test_a_field_that_no_rule_writes_is_refused(model: type[BaseModel]) -> None:
    with pytest.raises(NoInterface):
        fields_of(model, request=False)


def test_a_mark_counts_behind_any_check() -> None:
    class Marked(BaseModel):
        began: Instant | None
        params: TaskParams
        share: float

    assert [one.declared for one in fields_of(Marked, request=False)] == [
        "builtin_interfaces/Time[<=1]",
        "rodeo_msgs/TaskParams",
        "float64",
    ]


def test_names_of_interfaces_and_services() -> None:
    assert interface_name("task/{id}") == "Task"
    assert interface_name("budget_votes") == "BudgetVotes"
    assert service_name("GetBudgetVotes") == "get_budget_votes"


def test_debians_rosidl_reads_every_file_and_the_idl_that_it_makes_of_it(tmp_path: Path) -> None:
    system = "/usr/bin/python3"
    tried = ["-c", "import em, rosidl_adapter, rosidl_parser"]
    if not Path(system).exists() or subprocess.run([system, *tried], capture_output=True).returncode:
        pytest.skip("rosidl-tools is missing: make system")
    done = subprocess.run(
        [system, str(ROOT / "tests/support/rosidl.py"), str(ROOT / "rodeo_msgs"), str(tmp_path)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert set(done.stderr.split()) == {one.path for one in interfaces()}
