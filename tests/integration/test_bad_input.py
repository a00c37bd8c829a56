"""Bad input on the bus and in proofs: an error for whoever sent it, nothing lost, nobody else kept waiting.

What test_bridge.py and test_oracle.py refuse one by one is not repeated here.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.chain.contracts.abi import TaskRequest
from rodeo.chain.contracts.types import ZERO_ADDRESS
from rodeo.dao import Participant
from rodeo.errors import InvalidRequest, RemoteError
from rodeo.evidence.store import Store
from rodeo.signing import wallets
from rodeo_testing.recordings import START_NS, Sample, Take, seal
from rodeo_testing.waiting import HANG_S
from tests.support.dao import CHARGING, PARAMS, Dao, founded
from tests.support.site import NewSite

CLEANING = "waste_disposal"
TASK = {"kind": CLEANING, "reward_iec": "100", "params": PARAMS}
CHARGE = {"kind": "battery_charging", "reward_iec": "200", "params": CHARGING}
SERVICE = {"kind": CLEANING, "price_iec": "1"}


@pytest.fixture(scope="module")
def dao(new_site: NewSite) -> Iterator[Dao]:
    """One organization whose only cleaner is panther1."""
    with founded(new_site("oracle.handover_s = 1"), "oracle") as organization:
        organization.command("panther1", "register_service", kind=CLEANING, price_iec="100")
        yield organization


def send(dao: Dao, key: str, payload: Any = None) -> dict[str, Any]:
    """Ask `rodeo/<org>/<key>`; a payload in bytes goes as it is."""
    body = payload if isinstance(payload, bytes | None) else json.dumps(payload).encode()
    return dao.running.bus.query(f"rodeo/{dao.site.org}/{key}", body, timeout_s=HANG_S)


def refusal(dao: Dao, key: str, payload: Any = None) -> RemoteError:
    with pytest.raises(RemoteError) as refused:
        send(dao, key, payload)
    return refused.value


def everything(dao: Dao) -> Any:
    """What a refused request must leave as it is."""
    return dao.balances(), dao.state("tasks")["total"], dao.state("services"), dao.state("chain")["head"]


@pytest.mark.parametrize(
    ("command", "request_", "field"),
    [
        *(
            ("register_task", TASK | {"reward_iec": amount}, "reward_iec")
            for amount in ("NaN", "Infinity", "1e400", "1e-19", "9" * 40, "", "ten", True, None, [])
        ),
        *(("register_task", TASK | {"params": params}, "params") for params in ("x", None, [])),
        *(
            ("register_task", TASK | {"params": PARAMS | {field: value}}, field)
            for field, value in (
                ("x_m", "NaN"),
                ("x_m", "1"),
                ("y_m", True),
                ("y_m", None),
                ("x_m", 10**400),
                ("y_m", 1e300),
                ("item_id", 1),
                ("item_id", "x" * 65),
            )
        ),
        *(
            ("register_task", CHARGE | {"params": CHARGING | {field: value}}, field)
            for field, value in (
                ("robot", None),
                ("dock", 1),
                ("soc_from", -0.1),
                ("soc_target", 1.1),
                ("soc_target", "0.9"),
                ("energy_wh", 0),
                ("energy_wh", 1e300),
                ("energy_wh", None),
            )
        ),
        ("register_task", TASK | {"description": "x" * 2001}, "description"),
        ("register_task", TASK | {"max_attempts": 256}, "max_attempts"),
        ("register_task", TASK | {"execution_window_s": 2**32}, "execution_window_s"),
        ("register_task", TASK | {"verdict_window_s": -1}, "verdict_window_s"),
        ("register_task", TASK | {"request_id": "x" * 129}, "request_id"),
        ("register_service", SERVICE | {"price_iec": "-1"}, "price_iec"),
        ("register_service", SERVICE | {"price_iec": "1e30"}, "price_iec"),
        ("update_service", {"service_id": 2**63}, "service_id"),
        ("update_service", {"service_id": 1, "state": "asleep"}, "state"),
        ("cancel_task", {"task_id": 2**256}, "task_id"),
        ("expire_task", {"task_id": "first"}, "task_id"),
        ("transfer", {"to": "oracle", "amount_iec": "0"}, "amount_iec"),
        ("transfer", {"amount_iec": "1"}, "to"),
        ("submit_proof", {"task_id": 1, "attempt": 2**8, "proof_sha256": "aa", "proof_uri": ""}, "attempt"),
    ],
)
def test_each_wrong_field_is_named(dao: Dao, command: str, request_: dict[str, Any], field: str) -> None:
    before = everything(dao)
    error = refusal(dao, f"wallet/panther1/{command}", request_)
    assert (error.code, field in error.details["fields"]) == ("invalid_request", True), error
    assert everything(dao) == before


@pytest.mark.parametrize(
    ("command", "request_", "code"),
    [
        ("register_task", TASK | {"max_attempts": 11}, "invalid_attempts"),
        ("register_task", TASK | {"execution_window_s": 59}, "invalid_window"),
        ("register_task", TASK | {"verdict_window_s": 7 * 86_400 + 1}, "invalid_verdict_window"),
        ("register_service", SERVICE, "already_offered"),
        ("register_service", SERVICE | {"kind": "battery_charging"}, "cannot_do"),
        ("update_service", {"service_id": 1, "price_iec": "0.0000000015"}, "invalid_price"),
        ("register_service", {"kind": "dance", "price_iec": "1"}, "unknown_kind"),
        ("transfer", {"to": "0x" + "0" * 40, "amount_iec": "1"}, "erc20_invalid_receiver"),
        ("transfer", {"to": "0x12", "amount_iec": "1"}, "unknown_participant"),
    ],
)
def test_what_only_the_contracts_know_is_refused_in_their_words(
    dao: Dao, command: str, request_: dict[str, Any], code: str
) -> None:
    before = everything(dao)
    assert refusal(dao, f"wallet/panther1/{command}", request_).code == code
    assert everything(dao) == before


def test_a_number_too_large_for_a_double_is_not_json(dao: Dao) -> None:
    # As an infinity it would go on chain, and no list of tasks with it could be read any more.
    payload = json.dumps(TASK).replace("2.0", "1e999").encode()
    assert b"1e999" in payload
    assert refusal(dao, "wallet/organization/register_task", payload).code == "malformed_json"
    dao.state("tasks")


def test_a_task_that_goes_around_the_bridge_leaves_lists_readable(dao: Dao) -> None:
    client = dao.client()
    text = '{"params":{"x_m":1e999},"description":"' + "x" * 16_000 + '"}'
    request = client.calls.register_task
    account = wallets.load(dao.site, "panther1")
    client.send(account, client.calls.approve(client.task_manager, 10**18))
    before = dao.state("chain")["last_seq"]
    for _ in range(18):
        client.send(
            account, request(TaskRequest(CLEANING, 0, 3600, 3600, 1, bytes(32), 0, ZERO_ADDRESS, text))
        )
    dao.wait_for(
        lambda: sum(event.name == "TaskRegistered" for event in list(dao.events) if event.seq > before) == 18,
        "eighteen long tasks",
    )
    listed = dao.state("tasks", state="open")["tasks"]
    assert [task["params"] for task in listed] == [{}] * 18
    for task in listed:
        dao.command("panther1", "cancel_task", task_id=task["id"])


def test_the_place_of_a_listed_item_follows_from_its_id(dao: Dao) -> None:
    request_ = TASK | {"params": {"item_id": "item1"}, "reward_iec": "1", "allow_wait": True}
    task_id = dao.command("organization", "register_task", **request_)["task_id"]
    pose = next(one.pose for one in dao.site.items if one.id == "item1")
    posted = dao.state(f"task/{task_id}")["params"]
    dao.command("organization", "cancel_task", task_id=task_id)
    assert (posted["x_m"], posted["y_m"]) == (pose.x_m, pose.y_m)


def test_texts_that_everybody_would_keep_for_ever_are_bounded(dao: Dao) -> None:
    error = refusal(
        dao, "wallet/organization/register_task", TASK | {"params": PARAMS | {"note": "x" * 20_000}}
    )
    assert (error.code, error.details["limit"]) == ("invalid_request", 16_384)


@pytest.mark.parametrize("participant", ["bob", "*", "**", "panther1-device"])
def test_an_unknown_participant_is_told_who_there_is(dao: Dao, participant: str) -> None:
    before = everything(dao)
    error = refusal(dao, f"wallet/{participant}/transfer", {"to": "oracle", "amount_iec": "1"})
    assert (error.code, error.details["known"]) == (
        "unknown_participant",
        ["oracle", "organization", "panther1"],
    )
    assert everything(dao) == before


@pytest.mark.parametrize("key", ["wallet/panther1", "wallet/panther1/*", "wallet/panther1/transfer/all"])
def test_an_unknown_command_is_told_what_there_is(dao: Dao, key: str) -> None:
    error = refusal(dao, key, {"to": "oracle", "amount_iec": "1"})
    assert error.code == "unknown_command" and "transfer" in error.details["known"]


@pytest.mark.parametrize("what", ["task/" + "9" * 30, "task/-1", "task/1/2"])
def test_a_task_that_cannot_be_is_unknown(dao: Dao, what: str) -> None:
    assert refusal(dao, f"state/{what}").code == "unknown_task"


def test_a_key_that_is_none_is_refused_by_the_sender_itself(dao: Dao) -> None:
    with pytest.raises(InvalidRequest):
        send(dao, "wallet//transfer", {})


def test_a_task_that_is_being_done_cannot_be_cancelled(dao: Dao, assigned: int) -> None:
    error = refusal(dao, "wallet/organization/cancel_task", {"task_id": assigned})
    assert (error.code, error.details["current"]) == ("wrong_state", "assigned")
    assert dao.task(assigned)["state"] == "assigned"


def test_only_its_creator_cancels_a_task(dao: Dao, assigned: int) -> None:
    waiting = dao.post()
    assert refusal(dao, "wallet/panther1/cancel_task", {"task_id": waiting}).code == "not_creator"
    dao.command("organization", "cancel_task", task_id=waiting)


def test_only_its_executor_submits_a_proof_and_only_for_the_running_attempt(dao: Dao, assigned: int) -> None:
    proof = {
        "task_id": assigned,
        "attempt": 1,
        "proof_sha256": "0x" + "a" * 64,
        "proof_uri": f"{dao.site.store_url}/{'a' * 64}.mcap",
    }
    assert refusal(dao, "wallet/oracle/submit_proof", proof).code == "not_executor"
    assert refusal(dao, "wallet/panther1/submit_proof", proof | {"attempt": 2}).code == "wrong_attempt"
    assert dao.task(assigned)["state"] == "assigned"


def test_rubbish_on_every_key_stops_nobody(dao: Dao) -> None:
    org, session = dao.site.org, dao.running.bus.session
    keys = [
        f"rodeo/{org}/event/TaskAssigned",
        f"rodeo/{org}/status/bridge",
        f"rodeo/{org}/itrash/itrash/classification",
        f"{dao.site.bus.domain_id}/clock/rosgraph_msgs::msg::dds_::Clock_/RIHS01_0",
        f"{dao.site.bus.domain_id}/panther1/battery_state/x/y",
    ]
    payloads = [
        b"",
        b"{",
        b"[]",
        b"\xff" * 3,
        b'{"seq": "many"}',
        b"[" * 100_000,
        b"\x00\x01\x00\x00" + b"\x7f" * 8,
    ]
    for _ in range(20):
        for key in keys:
            for payload in payloads:
                session.put(key, payload)
    beyond = DaoEvent(
        seq=10**9, name="TaskFailed", block=1, log_index=0, tx_hash="0x", time_s=0, task_id=1, args={}
    )
    dao.running.bus.put_json(f"rodeo/{org}/event/TaskFailed", beyond)
    before = dao.balances()
    dao.command("organization", "transfer", to="oracle", amount_iec="1")
    dao.command("oracle", "transfer", to=dao.state("chain")["organization"], amount_iec="1")
    assert dao.balances() == before
    assert dao.state("chain")["time_s"] < 0x7F7F7F7F, "rubbish was taken for the time"
    dao.catch_up()


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "readable_and_sealed: "),
        (b"\x89MCAP0\r\n" + b"\xff" * 5000, "readable_and_sealed: "),
        (b"PK\x03\x04" + b"\x00" * 5000, "readable_and_sealed: corrupt_proof"),
    ],
)
def test_what_is_no_recording_gets_a_verdict(dao: Dao, assigned: int, data: bytes, reason: str) -> None:
    uri, sha256 = Store(dao.site).put_bytes(data, ".mcap")
    Participant(dao.running.bus, dao.site.org, "panther1").submit_proof(assigned, 1, sha256, uri)
    assert verdict(dao, assigned, 1).startswith(reason)


def test_a_recording_of_the_attempt_before_is_refused(dao: Dao, tmp_path: Path) -> None:
    task_id = dao.post(max_attempts=2)
    panther = Participant(dao.running.bus, dao.site.org, "panther1")
    device = wallets.load(dao.site, "panther1-device")
    path = tmp_path / "first.mcap"
    take = Take([Sample("rodeo/attestation", "", {"n": n}, START_NS + n * 10**8) for n in range(20)])
    seal(take, path, panther.binding(panther.task(task_id), "panther1"), device)
    dao.prove(task_id, digit="c")
    assert "the executor did not send it" in verdict(dao, task_id, 1)
    uri, sha256 = Store(dao.site).put_bytes(path.read_bytes(), ".mcap")
    panther.submit_proof(task_id, 2, sha256, uri)
    assert verdict(dao, task_id, 2).startswith("task_binding")


@pytest.fixture
def assigned(dao: Dao) -> Iterator[int]:
    """A task with one attempt, which panther1 has to do; over at the end."""
    task_id = dao.post(max_attempts=1)
    assert dao.task(task_id)["executor_name"] == "panther1"
    yield task_id
    if dao.task(task_id)["state"] == "assigned":
        dao.prove(task_id, digit="abcdef"[task_id % 6])
        dao.wait_for(lambda: "TaskFailed" in dao.names_of(task_id), "the verdict")


def verdict(dao: Dao, task_id: int, attempt: int) -> str:
    """Reason of the oracle's rejection."""

    def ruled() -> list[DaoEvent]:
        of = [event for event in list(dao.events) if (event.name, event.task_id) == ("Ruled", task_id)]
        return [event for event in of if event.args["attempt"] == attempt]

    dao.wait_for(lambda: bool(ruled()), f"a ruling on task {task_id} attempt {attempt}")
    assert [event.args["ruling"] for event in ruled()] == ["rejected"]
    sent = ruled()[0].tx_hash
    (reported,) = (event for event in list(dao.events) if (event.name, event.tx_hash) == ("Reported", sent))
    return str(reported.args["reason"])
