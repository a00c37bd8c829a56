"""The money path over the bus: real router, chain and bridge; participants played by the test."""

from __future__ import annotations

import json
import os
import sqlite3
import threading
import time
import urllib.request
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account
from web3 import Web3

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, Status, Task
from rodeo.bus.session import Bus, DaoEvents
from rodeo.dao import Participant
from rodeo.errors import NoResponder, QueryTimeout, RemoteError
from rodeo.evidence.store import Store
from rodeo.signing import keystores, possession, wallets
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.witness.days import SignedDay, day_of
from rodeo.witness.roots import DailyRoots
from rodeo.witness.statement import Removal
from rodeo.witness.witness import Witness
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.command import rodeo
from tests.support.dao import CHARGING, PARAMS, Dao, founded
from tests.support.index import index_differences
from tests.support.site import NewSite, RunningSite, readyz

CLEANING = "waste_disposal"


@pytest.fixture(scope="module")
def dao(new_site: NewSite) -> Iterator[Dao]:
    """One organization for the tests that leave it as they found it: a settled task, one idle cleaner."""
    extra = 'participants = [{ name = "carla" }]'
    with founded(new_site(extra)) as organization:
        organization.command("panther1", "register_service", kind=CLEANING, price_iec="100")
        first = organization.post()
        organization.prove(first)
        organization.judge(first, accepted=True)
        yield organization


@pytest.fixture(scope="module")
def site_to_break(new_site: NewSite) -> Iterator[Dao]:
    with founded(new_site()) as organization:
        yield organization


@pytest.fixture
def own_dao(site_to_break: Dao) -> Dao:
    """An organization to break, whole at the start: everything runs, and panther1 has an idle cleaner."""
    running = site_to_break.running
    running.start(*({"router", "chain", "bridge"} - running.children.keys()), ready=False)
    running.wait_ready("bridge")
    for service in site_to_break.state("services", provider="panther1", kind=CLEANING)["services"]:
        if service["state"] != "retired":
            # It may be at work for a test that is over.
            site_to_break.command("panther1", "update_service", service_id=service["id"], state="retired")
    site_to_break.command("panther1", "register_service", kind=CLEANING, price_iec="100")
    return site_to_break


AGAIN_S = 20.0
"""Wall time after which a request is sent again: its bridge may have been killed."""


def retried(dao: Dao, participant: str, command: str, **fields: Any) -> dict[str, Any]:
    """Ask until there is an answer, as a participant does whose bridge or node went away."""
    key = topics.COMMAND.name(org=dao.site.org, participant=participant, command=command)

    def answer() -> dict[str, Any] | None:
        try:
            return dao.running.bus.query(key, fields, timeout_s=AGAIN_S)
        except (NoResponder, QueryTimeout):
            return None
        except RemoteError as error:
            if error.code not in ("bridge_not_ready", "chain_unavailable", "transaction_timeout"):
                raise
            return None

    return wait_until(answer, lambda: dao.running.log("bridge"))


def events_from_the_beginning(dao: Dao) -> list[dict[str, Any]]:
    """What somebody hears who subscribes only now."""
    last, heard = dao.state("chain")["last_seq"], list[dict[str, Any]]()
    everything = threading.Event()

    def on_event(event: DaoEvent) -> None:
        heard.append(event.model_dump())
        if event.seq == last:
            everything.set()

    with DaoEvents(dao.running.bus, dao.site.org, on_event):
        assert everything.wait(HANG_S), heard
    return heard


def assert_index_equals_contracts(dao: Dao) -> None:
    assert index_differences(dao.state, dao.client()) == []


def test_a_task_is_assigned_proved_judged_and_paid(dao: Dao) -> None:
    before = dao.balances()
    task_id = dao.post("120", description="the can by the desk")
    task = dao.task(task_id)
    assert (task["state"], task["executor_name"], task["attempt"]) == ("assigned", "panther1", 1)
    assert task["params"] == PARAMS and task["description"] == "the can by the desk"
    assert dao.balances()["organization"] == before["organization"] - 120
    sha256 = dao.prove(task_id)
    assert dao.task(task_id)["state"] == "submitted"
    dao.judge(task_id, accepted=True)
    task = dao.task(task_id)
    assert (task["state"], task["verdict"], task["proof_sha256"]) == ("settled", "accepted", sha256)
    assert (task["reward_iec"], task["price_iec"], task["paid_iec"]) == ("120", "100", "100")
    after = dao.balances()
    assert after["organization"] == before["organization"] - 100
    assert after["panther1"] == before["panther1"] + 100
    dao.catch_up()
    assert dao.names_of(task_id) == [
        "TaskRegistered",
        "TaskAssigned",
        "ProofSubmitted",
        "Reported",
        "Ruled",
        "TaskSettled",
    ]
    assert_index_equals_contracts(dao)


def test_a_robot_pays_the_organization_for_a_charge(dao: Dao) -> None:
    service_id = dao.command("organization", "register_service", kind="battery_charging", price_iec="200")[
        "service_id"
    ]
    before = dao.balances()
    task_id = dao.command(
        "panther1", "register_task", kind="battery_charging", reward_iec="200", params=CHARGING
    )["task_id"]
    task = dao.task(task_id)
    assert (task["creator_name"], task["executor_name"]) == ("panther1", "organization")
    dao.prove(task_id, "organization")
    dao.judge(task_id, accepted=True)
    after = dao.balances()
    assert after["organization"] == before["organization"] + 200
    assert after["panther1"] == before["panther1"] - 200
    dao.command("organization", "update_service", service_id=service_id, state="retired")
    services = {service["id"]: service for service in dao.state("services")["services"]}
    assert (services[service_id]["state"], services[service_id]["price_iec"]) == ("retired", "200")
    with pytest.raises(RemoteError) as refused:
        dao.command("organization", "update_service", service_id=service_id, state="active")
    assert refused.value.code == "service_is_retired"
    with pytest.raises(RemoteError, match="withdrawn for good"):
        order = {"kind": "battery_charging", "params": CHARGING, "service_id": service_id}
        dao.command("panther1", "register_task", reward_iec="200", allow_wait=True, **order)


def test_a_task_that_waits_is_posted_again_for_a_higher_reward(dao: Dao) -> None:
    busy = dao.post()
    before = dao.balances()
    waiting = dao.post(reward_iec="100", max_attempts=2)
    creator = Participant(dao.running.bus, dao.running.site.org, "organization")
    raised = creator.raise_reward(waiting, Decimal("110.5"))
    assert creator.raise_reward(waiting, Decimal("110.5")) == raised, "asked again, it is not raised again"
    assert dao.task(waiting)["state"] == "cancelled"
    old, new = dao.task(waiting), dao.task(raised)
    assert (new["state"], new["reward_iec"]) == ("open", "110.5")
    same = ("kind", "params", "description", "max_attempts", "execution_window_s", "rules_sha256")
    assert [new[name] for name in same] == [old[name] for name in same]
    assert dao.balances()["organization"] == before["organization"] - 110.5
    for task_id, reward_iec in ((raised, 110), (busy, 500), (10**6, 500)):
        with pytest.raises(RemoteError) as refused:
            creator.raise_reward(task_id, Decimal(reward_iec))
        assert refused.value.code == ("unknown_task" if task_id == 10**6 else "cannot_raise")
    # What was cancelled halfway through is posted again.
    dao.command("organization", "cancel_task", task_id=raised)
    again = creator.raise_reward(raised, Decimal(120))
    assert dao.task(again)["reward_iec"] == "120"
    dao.command("organization", "cancel_task", task_id=again)
    assert dao.balances() == before
    dao.prove(busy)
    dao.judge(busy, accepted=True)


@pytest.mark.long
def test_a_task_that_would_not_be_accepted_again_stays_as_it_is(dao: Dao) -> None:
    """Refused after it was cancelled, it would be gone."""
    busy, before = dao.post(), dao.balances()
    everything = str(before["organization"] - 1)
    waiting, alone = dao.post(reward_iec="100"), dao.post(reward_iec="1", allow_wait=True)

    def refused(task_id: int, reward_iec: str) -> str:
        with pytest.raises(RemoteError) as refusal:
            dao.command("organization", "raise_reward", task_id=task_id, reward_iec=reward_iec)
        assert dao.task(task_id)["state"] == "open"
        return refusal.value.code

    dao.command("organization", "pause_tasks", duration_s=3600)
    assert refused(waiting, "110") == "tasks_are_paused"
    # What is in escrow pays, too, and is not there yet.
    assert refused(waiting, everything) == "tasks_are_paused"
    dao.command("organization", "resume_tasks")
    dao.command("organization", "set_budget", role="operator", amount_iec="1", period_s=3600)
    assert refused(waiting, "110") == "over_budget"
    dao.command("organization", "set_budget", role="operator")
    raised = dao.command("organization", "raise_reward", task_id=waiting, reward_iec=everything)["task_id"]
    for task_id in (raised, alone):
        dao.command("organization", "cancel_task", task_id=task_id)
    assert dao.balances() == before
    dao.prove(busy)
    dao.judge(busy, accepted=True)


def test_an_unassigned_task_can_be_cancelled_and_its_reward_comes_back(dao: Dao) -> None:
    busy = dao.post()
    before = dao.balances()
    waiting = dao.post()
    assert dao.task(waiting)["state"] == "open"
    dao.command("organization", "cancel_task", task_id=waiting)
    assert dao.task(waiting)["state"] == "cancelled"
    assert dao.balances() == before
    with pytest.raises(RemoteError) as refused:
        dao.command("organization", "cancel_task", task_id=busy)
    assert refused.value.code == "wrong_state"
    assert refused.value.details == {"task_id": busy, "current": "assigned", "expected": "open"}
    dao.prove(busy)
    dao.judge(busy, accepted=True)


@pytest.mark.long
def test_a_rejected_task_is_tried_again_and_refunded_at_the_last(dao: Dao) -> None:
    before = dao.balances()
    task_id = dao.post(max_attempts=2)
    dao.prove(task_id, digit="c")
    dao.judge(task_id, accepted=False, reason="the item never left the floor")
    task = dao.task(task_id)
    # The only cleaner is free again and gets the second attempt at once.
    assert (task["state"], task["attempt"], task["proof_sha256"]) == ("assigned", 2, None)
    dao.prove(task_id, digit="d")
    dao.judge(task_id, accepted=False, reason="again")
    task = dao.task(task_id)
    assert (task["state"], task["verdict"], task["reason"]) == ("failed", "rejected", "again")
    assert dao.balances() == before
    assert_index_equals_contracts(dao)


@pytest.mark.long
def test_a_task_waits_for_the_service_that_it_names(dao: Dao) -> None:
    busy = dao.post()
    service_id = dao.task(busy)["service_id"]
    waiting = dao.post(service_id=service_id)
    waits = dao.task(waiting)
    assert (waits["state"], waits["service_id"], waits["requested_service_id"]) == ("open", None, service_id)
    assert_index_equals_contracts(dao)
    raised = dao.command("organization", "raise_reward", task_id=waiting, reward_iec="110")["task_id"]
    dao.prove(busy)
    dao.judge(busy, accepted=True)
    done = dao.task(raised)
    assert (done["state"], done["service_id"], done["requested_service_id"]) == (
        "assigned",
        service_id,
        service_id,
    )
    dao.prove(raised, digit="b")
    dao.judge(raised, accepted=True)
    with pytest.raises(RemoteError) as unknown:
        dao.post(service_id=9999)
    assert unknown.value.code == "unknown_service"


@pytest.mark.long
def test_a_task_waits_for_the_provider_that_it_names(dao: Dao) -> None:
    busy = dao.post()
    waiting = dao.post(provider="panther1")
    waits = dao.task(waiting)
    assert (waits["state"], waits["service_id"], waits["requested_service_id"]) == ("open", None, None)
    assert (waits["requested_provider"], waits["requested_provider_name"]) == (
        dao.task(busy)["executor"],
        "panther1",
    )
    assert_index_equals_contracts(dao)
    raised = dao.command("organization", "raise_reward", task_id=waiting, reward_iec="110")["task_id"]
    dao.prove(busy)
    dao.judge(busy, accepted=True)
    done = dao.task(raised)
    assert (done["state"], done["executor_name"]) == ("assigned", "panther1")
    dao.prove(raised, digit="b")
    dao.judge(raised, accepted=True)
    assert_index_equals_contracts(dao)


def test_a_task_names_a_service_or_a_provider_that_does_such_work(dao: Dao) -> None:
    for wrong, code in (
        ({"provider": "0x" + "5e" * 20}, "provider_without_service"),
        ({"provider": "nobody"}, "unknown_participant"),
        ({"provider": "organization"}, "invalid_request"),
        ({"provider": "panther1", "service_id": 1}, "invalid_request"),
        ({"provider": "panther1", "reward_iec": "1"}, "reward_below_price"),
    ):
        with pytest.raises(RemoteError) as refused:
            dao.post(**wrong)
        assert refused.value.code == code


@pytest.mark.long
def test_overdue_tasks_are_expired_and_concluded_by_the_bridge(dao: Dao) -> None:
    before = dao.balances()
    task_id = dao.post(max_attempts=2, execution_window_s=600, verdict_window_s=900)
    deadline_s = dao.task(task_id)["execution_deadline"]
    dao.set_clock(deadline_s + 2)
    dao.wait_for(lambda: "TaskRequeued" in dao.names_of(task_id), "the first expiry")
    dao.wait_for(lambda: dao.names_of(task_id).count("TaskAssigned") == 2, "the second assignment")
    dao.prove(task_id)
    dao.set_clock(dao.task(task_id)["verdict_deadline"] + 2)
    dao.wait_for(lambda: "Ruled" in dao.names_of(task_id), "the end of the verdict window")
    task = dao.task(task_id)
    assert (task["state"], task["standing"]["ruling"], task["reason"]) == ("ruled", "void", None)
    dao.set_clock(task["case_end"] + 2)
    dao.wait_for(lambda: "TaskFailed" in dao.names_of(task_id), "the end of the case")
    task = dao.task(task_id)
    assert (task["state"], task["verdict"], task["fault"]) == ("failed", "void", "oracle")
    assert dao.balances() == before  # nobody is paid for what nobody judged
    assert_index_equals_contracts(dao)


def test_every_event_comes_once_in_chain_order_and_after_its_state(dao: Dao) -> None:
    states: dict[str, str] = {}
    done = threading.Event()

    def on_event(_key: str, data: dict[str, Any]) -> None:
        event = DaoEvent.model_validate(data)
        if event.task_id is not None:
            states[event.name] = dao.task(event.task_id)["state"]
        if event.name == "TaskSettled":
            done.set()

    bus = Bus.open(dao.site.bus.router, timeout_s=HANG_S)
    bus.subscribe_json(f"rodeo/{dao.site.org}/event/*", on_event)
    task_id = dao.post()
    dao.prove(task_id)
    dao.judge(task_id, accepted=True)
    assert done.wait(HANG_S)
    bus.close()
    rank = ["open", "assigned", "submitted", "settled"]
    least = {"TaskRegistered": 0, "TaskAssigned": 1, "ProofSubmitted": 2, "TaskSettled": 3}
    for name, expected in least.items():
        assert rank.index(states[name]) >= expected
    dao.catch_up()
    assert [event.seq for event in dao.events] == list(range(1, len(dao.events) + 1))
    places = [(event.block, event.log_index) for event in dao.events]
    assert places == sorted(places)


def test_the_same_request_twice_is_done_once(dao: Dao) -> None:
    first = dao.post(request_id="once")
    assert dao.post(request_id="once") == first
    with pytest.raises(RemoteError) as refused:
        dao.post("101", request_id="once")
    assert refused.value.code == "request_id_reused"
    dao.prove(first)
    dao.judge(first, accepted=True)


def test_tokens_move_between_participants(dao: Dao) -> None:
    before = dao.balances()
    dao.command("organization", "transfer", to="oracle", amount_iec="1.5")
    oracle = dao.state("wallets")["wallets"][2]
    assert (oracle["name"], oracle["balance_iec"]) == ("oracle", "1.5")
    dao.command("oracle", "transfer", to=dao.state("chain")["organization"], amount_iec="1.5")
    assert dao.balances() == before


@pytest.mark.parametrize(
    ("participant", "command", "fields", "code"),
    [
        ("organization", "register_task", {"kind": "dance", "reward_iec": "1"}, "unknown_kind"),
        ("organization", "register_task", {"kind": "Not A Kind", "reward_iec": "1"}, "invalid_request"),
        ("organization", "register_task", {"kind": CLEANING, "reward_iec": "100"}, "invalid_request"),
        ("organization", "register_task", {"kind": CLEANING, "reward_iec": "-1"}, "invalid_request"),
        (
            "organization",
            "register_task",
            {"kind": CLEANING, "reward_iec": "100", "params": PARAMS, "reward": 1},
            "invalid_request",
        ),
        (
            "organization",
            "register_task",
            {"kind": CLEANING, "reward_iec": "99.9", "params": PARAMS},
            "reward_below_price",
        ),
        (
            "organization",
            "register_task",
            {"kind": CLEANING, "reward_iec": "5000", "params": PARAMS},
            "insufficient_funds",
        ),
        (
            "organization",
            "register_task",
            {"kind": CLEANING, "reward_iec": "100", "params": PARAMS, "execution_window_s": 1},
            "invalid_window",
        ),
        ("oracle", "transfer", {"to": "panther1", "amount_iec": "1"}, "insufficient_funds"),
        ("oracle", "transfer", {"to": "nobody", "amount_iec": "1"}, "unknown_participant"),
        ("oracle", "cancel_task", {"task_id": 12345}, "unknown_task"),
        ("oracle", "expire_task", {"task_id": 12345}, "unknown_task"),
        ("oracle", "update_service", {"service_id": 12345}, "unknown_service"),
        ("oracle", "update_service", {"service_id": 1, "price_iec": "1"}, "not_provider"),
        ("oracle", "make_coffee", {}, "unknown_command"),
        (
            "panther1",
            "rule",
            {
                "task_id": 1,
                "attempt": 1,
                "proof_sha256": "0x" + "a" * 64,
                "ruling": "accepted",
                "amount_iec": "1",
                "reason": "mine",
                "report_sha256": "0x" + "b" * 64,
                "report_uri": "",
            },
            "not_in_role",
        ),
        *(
            (
                "panther1",
                "submit_proof",
                {"task_id": 1, "attempt": 1, "proof_sha256": "0x" + "a" * 64, "proof_uri": uri},
                "proof_uri_not_allowed",
            )
            for uri in (
                "http://evil.example/x.mcap",
                "file:///etc/passwd",
                f"file:///tmp/../{'a' * 64}.mcap",
                "data:,x",
            )
        ),
    ],
)
def test_bad_input_is_refused_by_name_and_changes_nothing(
    dao: Dao, participant: str, command: str, fields: dict[str, Any], code: str
) -> None:
    before = (dao.balances(), dao.state("tasks")["total"], dao.state("chain")["head"])
    with pytest.raises(RemoteError) as refused:
        dao.command(participant, command, **fields)
    assert refused.value.code == code, refused.value
    assert (dao.balances(), dao.state("tasks")["total"], dao.state("chain")["head"]) == before


@pytest.mark.parametrize(
    "payload", [b"{", b"[]", b"\xff", b"[" * 5000, b'{"a": "' + b"x" * (1 << 20) + b'"}']
)
def test_what_is_no_json_object_is_refused(dao: Dao, payload: bytes) -> None:
    with pytest.raises(RemoteError) as refused:
        dao.running.bus.query(f"rodeo/{dao.site.org}/wallet/panther1/register_task", payload)
    assert refused.value.code == "malformed_json"


@pytest.mark.parametrize(
    ("what", "parameters", "code"),
    [
        ("task/9999", {}, "unknown_task"),
        ("task/x", {}, "unknown_task"),
        ("weather", {}, "unknown_query"),
        ("tasks", {"limit": 100_000}, "invalid_request"),
        ("tasks", {"state": "lost"}, "invalid_request"),
        ("tasks", {"state": "open,lost"}, "invalid_request"),
        ("transfers", {"account": "nobody"}, "unknown_participant"),
        ("transfers", {"first_s": "nan"}, "invalid_request"),
        ("history", {"bucket_s": 0}, "invalid_request"),
        ("wallet", {"account": "nobody"}, "unknown_participant"),
        ("tasks", {"colour": "red"}, "invalid_request"),
        ("tasks", {"executor": "nobody"}, "unknown_participant"),
        ("events", {"after": -1}, "invalid_request"),
    ],
)
def test_bad_questions_are_refused_by_name(
    dao: Dao, what: str, parameters: dict[str, Any], code: str
) -> None:
    with pytest.raises(RemoteError) as refused:
        dao.state(what, **parameters)
    assert refused.value.code == code


def test_a_price_above_the_reward_can_wait_for_a_cheaper_service(dao: Dao) -> None:
    task_id = dao.post("40", allow_wait=True)
    assert dao.task(task_id)["state"] == "open"
    (service,) = [one for one in dao.state("services")["services"] if one["kind"] == CLEANING]
    dao.command("panther1", "update_service", service_id=service["id"], price_iec="40")
    assert dao.task(task_id)["state"] == "assigned"
    dao.prove(task_id)
    dao.judge(task_id, accepted=True)
    dao.command("panther1", "update_service", service_id=service["id"], price_iec="100")


def test_tasks_are_listed_by_filter_and_page(dao: Dao) -> None:
    everything = dao.state("tasks", limit=500)
    mine = dao.state("tasks", creator="organization", state="settled")
    assert 0 < mine["total"] <= everything["total"]
    assert {task["creator_name"] for task in mine["tasks"]} == {"organization"}
    page = dao.state("tasks", limit=2, offset=1)
    assert page["tasks"] == everything["tasks"][1:3] and page["total"] == everything["total"]


def test_devices_are_known_with_their_roles_and_owners(dao: Dao) -> None:
    devices = dao.state("devices")["devices"]
    assert {(device["role"], device["name"], device["owner_name"]) for device in devices} == {
        ("robot", "panther1", "panther1"),
        ("bin", "itrash", "organization"),
        ("meter", "dock1", "organization"),
        ("mocap", "mocap", "organization"),
    }
    assert all(device["revoked"] is None for device in devices)


def test_the_organization_keeps_its_devices_kinds_and_treasury(dao: Dao) -> None:
    key = Account.from_key("0x" + "12" * 32)
    device, client = key.address, dao.client()

    def of(owner: str, nonce: int = 0) -> dict[str, str]:
        of_chain = client.w3.eth.chain_id, client.deployment.address("DeviceRegistry")
        signature = possession.sign(key, keystores.address(dao.site, owner), nonce, *of_chain)
        return {"device": device, "role": "mocap", "owner": owner, "signature": signature}

    request = of("carla")
    with pytest.raises(RemoteError) as refused:
        dao.command("organization", "register_device", **request, name="mocap")
    assert refused.value.code == "device_name_taken"
    with pytest.raises(RemoteError) as refused:
        dao.command("organization", "register_device", **request | {"owner": "panther1"}, name="mocap2")
    assert refused.value.code == "not_signed_by_device"
    # It turns out to be panther1's.
    dao.command("organization", "register_device", **request, name="mocap2")
    dao.command("organization", "register_device", **of("panther1", 1), name="mocap2")
    (known,) = [one for one in dao.state("devices")["devices"] if one["address"] == device]
    assert (known["role"], known["name"], known["owner_name"]) == ("mocap", "mocap2", "panther1")
    assert (known["revoked"], known["revoked_because"]) == (None, None)
    with pytest.raises(RemoteError) as refused:
        dao.command("organization", "revoke_device", device=device)
    assert refused.value.code == "invalid_request"
    dao.command("organization", "revoke_device", device=device, reason="compromised")
    (known,) = [one for one in dao.state("devices")["devices"] if one["address"] == device]
    assert known["revoked"] is not None and known["revoked_because"] == "compromised"
    # Nobody allows a kind without saying who judges it, and the oracle judges what it has checks for.
    for fields, code in (({}, "invalid_request"), ({"judge": "oracle"}, "kind_without_checks")):
        with pytest.raises(RemoteError) as refused:
            dao.command("organization", "allow_kind", kind="watering", **fields)
        assert refused.value.code == code
    assert "watering" not in dao.state("chain")["kinds"]
    dao.command("organization", "allow_kind", kind="watering", judge="auditor", min_window_s=60)
    (watering,) = [one for one in dao.state("organization")["kinds"] if one["kind"] == "watering"]
    told = ("allowed", "judge", "removed", "min_window_s", "audit_window_s", "rules_sha256")
    assert [watering[name] for name in told] == [True, "auditor", False, 60, 0, []]
    dao.command("organization", "allow_kind", kind="watering", allowed=False)
    assert "watering" not in dao.state("chain")["kinds"]
    before = dao.balances()
    dao.command("organization", "deposit", amount_iec="30")
    dao.command("organization", "withdraw", to="panther1", amount_iec="30")
    after = dao.balances()
    assert after["organization"] == before["organization"]
    assert after["panther1"] == before["panther1"] + 30
    dao.command("panther1", "transfer", to="organization", amount_iec="30")
    assert dao.balances() == {**before, "organization": before["organization"] + 30}
    for command, fields in {
        "deposit": {"amount_iec": "1"},
        "withdraw": {"to": "panther1", "amount_iec": "1"},
        "register_device": of("panther1", 2) | {"name": "b"},
        "allow_kind": {"kind": "watering", "judge": "auditor"},
    }.items():
        with pytest.raises(RemoteError) as refused:
            dao.command("panther1", command, **fields)
        assert refused.value.code == "access_control_unauthorized_account", command
    dao.command("organization", "withdraw", to="panther1", amount_iec="30")


def test_each_kind_of_the_site_says_who_judges_it_and_in_which_windows(dao: Dao) -> None:
    rules = {one["kind"]: one for one in dao.state("organization")["kinds"]}
    for kind in (CLEANING, "battery_charging"):
        assert (rules[kind]["allowed"], rules[kind]["judge"]) == (True, "oracle")
        assert rules[kind]["audit_window_s"] == 7 * 24 * 3600
    dao.command(
        "organization",
        "allow_kind",
        kind=CLEANING,
        judge="oracle",
        audit_window_s=3600,
        min_verdict_window_s=1800,
        max_verdict_window_s=7200,
    )
    with pytest.raises(RemoteError) as refused:
        dao.post("1", allow_wait=True, verdict_window_s=1799)
    assert refused.value.code == "invalid_verdict_window"
    (changed,) = [one for one in dao.state("organization")["kinds"] if one["kind"] == CLEANING]
    assert (changed["audit_window_s"], changed["number"]) == (3600, rules[CLEANING]["number"])
    assert (changed["min_verdict_window_s"], changed["max_verdict_window_s"]) == (1800, 7200)
    assert changed["rules_sha256"] == rules[CLEANING]["rules_sha256"] != []  # what was left out stays
    back = {"audit_window_s": rules[CLEANING]["audit_window_s"]}
    back |= {"min_verdict_window_s": 900, "max_verdict_window_s": 7 * 24 * 3600}
    dao.command("organization", "allow_kind", kind=CLEANING, judge="oracle", **back)


def test_an_oracle_judges_by_named_rules_and_a_creator_by_current_ones(dao: Dao) -> None:
    (before,) = [one for one in dao.state("organization")["kinds"] if one["kind"] == CLEANING]
    dao.command("organization", "allow_kind", kind=CLEANING, allowed=False)
    with pytest.raises(RemoteError) as refused:
        dao.command("organization", "allow_kind", kind=CLEANING, judge="oracle")
    assert refused.value.code == "kind_without_rules"
    own, other = ("0x" + digit * 64 for digit in "56")
    dao.command("organization", "allow_kind", kind=CLEANING, judge="oracle", rules_sha256=own)
    with pytest.raises(RemoteError) as refused:
        dao.post("1", allow_wait=True, rules_sha256=other)
    assert refused.value.code == "rules_not_current"
    assert refused.value.details == {"kind": CLEANING, "rules": other, "current": [own]}
    with pytest.raises(RemoteError) as refused:
        dao.command("organization", "retire_rules", kind=CLEANING, rules_sha256=own)
    assert refused.value.code == "kind_without_rules"
    dao.command("organization", "allow_kind", kind=CLEANING, judge="oracle", rules_sha256=other)
    for wanted, got in ((own, own), (None, other)):
        task_id = dao.post("1", allow_wait=True, **({} if wanted is None else {"rules_sha256": wanted}))
        assert dao.task(task_id)["rules_sha256"] == got
        dao.command("organization", "cancel_task", task_id=task_id)
    (installed,) = before["rules_sha256"]
    dao.command("organization", "allow_kind", kind=CLEANING, judge="oracle", rules_sha256=installed)
    for one in (own, other):
        dao.command("organization", "retire_rules", kind=CLEANING, rules_sha256=one)
    assert before in dao.state("organization")["kinds"]


def test_a_part_of_the_work_is_paid_in_part_and_the_ledger_tells_both(dao: Dao) -> None:
    before = dao.balances()
    task_id = dao.post("120")
    dao.prove(task_id)
    for fields, code in (
        ({"ruling": "accepted", "amount_iec": "100.5"}, "invalid_amount"),
        ({"ruling": "accepted", "amount_iec": "0"}, "invalid_amount"),
        ({"ruling": "accepted"}, "invalid_request"),
        ({"ruling": "rejected", "amount_iec": "1"}, "invalid_request"),
    ):
        with pytest.raises(RemoteError) as refused:
            dao.verdict(task_id, **fields)
        assert refused.value.code == code
    dao.verdict(task_id, "accepted", "a third", amount_iec="30.5")
    task = dao.task(task_id)
    assert (task["state"], task["verdict"]) == ("settled", "accepted")
    assert (task["paid_iec"], task["refunded_iec"], task["price_iec"]) == ("30.5", "89.5", "100")
    after = dao.balances()
    assert after["panther1"] == before["panther1"] + 30.5
    assert after["organization"] == before["organization"] - 30.5
    moved = dao.state("transfers", task_id=task_id)["transfers"]
    assert [(one["reason"], one["amount_iec"]) for one in reversed(moved)] == [
        ("escrow", "120"),
        ("payment", "30.5"),
        ("surplus", "89.5"),
    ]


@pytest.mark.long
def test_what_the_oracle_cannot_decide_auditors_do_and_without_them_it_is_void(dao: Dao) -> None:
    audited = dao.post("100")
    dao.prove(audited)
    dao.verdict(audited, "undecided", "the verification hung twice")
    task = dao.task(audited)
    assert (task["state"], task["verdict"], task["passed_on"]) == ("ruled", None, True)
    assert (task["standing"]["ruling"], task["standing"]["until"]) == ("void", task["case_end"])
    assert_index_equals_contracts(dao)
    with pytest.raises(RemoteError) as refused:
        dao.judge(audited, accepted=True)
    assert refused.value.code == "not_in_role"
    with pytest.raises(RemoteError) as refused:
        dao.verdict(audited, "undecided", "I do not know either", judge="organization")
    assert refused.value.code == "must_rule"
    # The robot is free for its next task meanwhile, and its proof is kept.
    silent = dao.post("100")
    assert dao.task(silent)["state"] == "assigned"
    dao.prove(silent, digit="c")
    dao.verdict(audited, "accepted", "seen on the recording", judge="organization", amount_iec="60")
    task = dao.task(audited)
    assert (task["state"], task["verdict"], task["paid_iec"]) == ("settled", "accepted", "60")

    before = dao.balances()
    dao.verdict(silent, "undecided", "the verification hung twice", fault="oracle")
    dao.set_clock(dao.task(silent)["case_end"] + 2)
    dao.wait_for(lambda: "TaskFailed" in dao.names_of(silent), "the end of the case")
    task = dao.task(silent)
    assert (task["state"], task["verdict"], task["fault"]) == ("failed", "void", "oracle")
    assert dao.balances()["panther1"] == before["panther1"]
    assert dao.state("organization")["voids"]["oracle"] >= 1


@pytest.mark.long
def test_what_a_judge_said_that_was_removed_is_void_and_the_next_one_needs_the_providers_word(
    dao: Dao,
) -> None:
    task_id, before = dao.post("100"), dao.state("organization")["kinds"]
    dao.prove(task_id)
    dao.verdict(task_id, "undecided", "a hang")
    (number, rules) = next((one["number"], one["rules_sha256"]) for one in before if one["kind"] == CLEANING)
    dao.command("organization", "remove_judge", kind=CLEANING)
    dao.wait_for(lambda: dao.names_of(task_id).count("Ruled") == 2, "the void of what it said")
    (kind,) = [one for one in dao.state("organization")["kinds"] if one["kind"] == CLEANING]
    assert (kind["allowed"], kind["removed"], kind["number"]) == (False, True, number)
    dao.verdict(task_id, "accepted", "seen", judge="organization", amount_iec="100")
    assert dao.task(task_id)["state"] == "settled"

    dao.command("organization", "allow_kind", kind=CLEANING, judge="oracle", rules_sha256=rules[-1])
    (offer,) = [one for one in dao.state("services", kind=CLEANING)["services"] if one["state"] == "active"]
    assert (offer["agrees"], offer["provider_name"]) == (False, "panther1")
    waiting = dao.post("100")
    assert dao.task(waiting)["state"] == "open"
    dao.command("panther1", "agree", service_id=offer["id"])
    assert dao.task(waiting)["state"] == "assigned"
    dao.prove(waiting, digit="d")
    dao.judge(waiting, accepted=True)
    (offer,) = [one for one in dao.state("services", kind=CLEANING)["services"] if one["state"] == "active"]
    assert offer["agrees"] is True
    assert_index_equals_contracts(dao)


def test_the_root_of_a_day_is_posted_once_and_known(dao: Dao) -> None:
    (device,) = [one for one in dao.state("devices")["devices"] if one["role"] == "robot"]
    fields = {"device": device["address"], "day": 3, "root": "0x" + "d" * 64, "uri": "file:///day"}
    with pytest.raises(RemoteError) as refused:
        dao.command("oracle", "post_root", **fields)
    assert refused.value.code == "not_device_owner"
    dao.command("panther1", "post_root", **fields)
    with pytest.raises(RemoteError) as refused:
        dao.command("organization", "post_root", **fields)
    assert refused.value.code == "root_already_posted"
    (root,) = dao.state("roots", device=device["address"])["roots"]
    assert {name: root[name] for name in fields} == fields and root["time_s"] > 0


def test_a_witness_posts_the_root_of_its_day_over_the_bus_once(dao: Dao, tmp_path: Path) -> None:
    account = wallets.load(dao.site, "itrash-device")
    organization = Participant(dao.running.bus, dao.site.org, "organization")
    now_s = dao.state("chain")["time_s"]
    for _ in range(2):  # started twice
        witness = Witness(dao.running.bus, dao.site.org, "itrash", account, tmp_path, "sensor", time.time_ns)
        roots = DailyRoots(dao.site, organization, witness)
        chain = wait_until(lambda: witness.chain, "nobody told for which organization it signs")  # noqa: B023
        for at_s in (now_s - 86_400, now_s):
            fields = {"compartment": "blue", "weight_n": 0.4, "after_s": at_s - 1, "settled_s": at_s}
            if len(chain.last(2)) < 2:
                chain.sign(Removal, at_s, **fields)
        roots.post_due()
        roots.close()
        witness.close()
    (root,) = dao.state("roots", device=account.address)["roots"]
    path = Store(dao.site).fetch(root["uri"], root["root"], folder=tmp_path / "fetched")
    log = SignedDay.load(path).log
    assert (log.device, log.day, log.first, log.count) == ("itrash", day_of(now_s - 86_400), 1, 1)


def test_a_dry_run_tells_the_cost_and_changes_nothing(dao: Dao) -> None:
    before = (dao.balances(), dao.state("tasks")["total"], dao.state("chain")["head"])
    task = {"kind": CLEANING, "reward_iec": "100", "params": PARAMS, "dry_run": True}
    cost = dao.command("organization", "register_task", **task, request_id="dry")
    assert cost["dry_run"] and cost["calls"] == ["registerTask"]
    assert 100_000 < cost["gas"] < 3_000_000 and int(cost["max_fee_wei"]) > 0
    with pytest.raises(RemoteError) as refused:
        dao.command("organization", "register_task", **{**task, "execution_window_s": 1})
    assert refused.value.code == "invalid_window"
    assert (dao.balances(), dao.state("tasks")["total"], dao.state("chain")["head"]) == before


def test_transfers_tell_the_task_and_the_reason_and_add_up(dao: Dao) -> None:
    task_id = dao.post("120")
    dao.prove(task_id)
    dao.judge(task_id, accepted=True)
    mine = dao.state("transfers", task_id=task_id, account="organization")["transfers"]
    assert [(one["reason"], one["change_iec"]) for one in reversed(mine)] == [
        ("escrow", "-120"),
        ("surplus", "20"),
    ]
    paid = dao.state("transfers", task_id=task_id, account="panther1")["transfers"]
    assert [(one["reason"], one["change_iec"]) for one in paid] == [("payment", "100")]
    everything = dao.state("transfers", account="panther1", limit=500)
    assert everything["total"] == len(everything["transfers"])
    balance = sum(float(one["change_iec"]) for one in everything["transfers"])
    assert balance == dao.balances()["panther1"] == float(everything["transfers"][0]["balance_iec"])
    page = dao.state("transfers", account="panther1", limit=1, offset=1)["transfers"]
    assert page == everything["transfers"][1:2]


def test_transactions_tell_what_a_task_cost(dao: Dao) -> None:
    task_id = dao.post()
    dao.prove(task_id)
    dao.judge(task_id, accepted=True)
    found = dao.state("transactions", task_id=task_id)
    assert found["total"] == 3
    assert [one["sender_name"] for one in found["transactions"]] == ["oracle", "panther1", "organization"]
    for one in found["transactions"]:
        receipt = dao.client().w3.eth.get_transaction_receipt(one["tx_hash"])
        assert one["gas_used"] == receipt["gasUsed"] and one["task_ids"] == [task_id]
        assert int(one["fee_wei"]) == receipt["gasUsed"] * receipt["effectiveGasPrice"]


def test_history_counts_every_task_once(dao: Dao) -> None:
    buckets = dao.state("history", bucket_s=60)["buckets"]
    assert sum(bucket["registered"] for bucket in buckets) == dao.state("tasks")["total"]
    settled = dao.state("tasks", state="settled")
    assert sum(bucket["settled"] for bucket in buckets) == settled["total"]
    paid = sum(float(task["paid_iec"]) for task in settled["tasks"])
    assert sum(float(bucket["paid_iec"]) for bucket in buckets) == paid


def test_tasks_are_found_by_their_text_and_by_several_states(dao: Dao) -> None:
    task_id = dao.post(description="The BLUE can; 100 % full")
    assert [task["id"] for task in dao.state("tasks", text="blue can")["tasks"]] == [task_id]
    assert [task["id"] for task in dao.state("tasks", text="can; 100 %")["tasks"]] == [task_id]
    assert dao.state("tasks", text="100_%")["total"] == 0
    live = dao.state("tasks", state="open,assigned,submitted")["tasks"]
    assert [task["id"] for task in live] == [task_id]
    dao.prove(task_id)
    dao.judge(task_id, accepted=True)


def test_participants_and_wallets_are_known_by_name(dao: Dao) -> None:
    people = {one["name"]: one for one in dao.state("participants")["participants"]}
    assert {name: one["role"] for name, one in people.items()} == {
        "organization": "organization",
        "panther1": "robot",
        "oracle": "oracle",
        "carla": "participant",
    }
    before = dao.state("wallet", account="organization")
    task_id = dao.post("110")
    wallet = dao.state("wallet", account="organization")
    assert float(wallet["in_escrow_iec"]) == float(before["in_escrow_iec"]) + 110
    dao.prove(task_id)
    dao.judge(task_id, accepted=True)
    people = {one["name"]: one for one in dao.state("participants")["participants"]}
    settled = dao.state("tasks", state="settled", executor="panther1")["total"]
    assert people["panther1"]["executed"]["settled"] == settled > 0
    roles = dao.state("organization")["roles"]
    assert [one["name"] for one in roles["ORACLE_ROLE"]] == ["oracle"]


@pytest.mark.parametrize(
    ("who", "kind", "why"),
    [
        (
            "panther1",
            "dusting",
            "panther1 cannot do dusting: robots do waste_disposal only",
        ),
        ("panther1", "battery_charging", "robots do waste_disposal only"),
        ("carla", CLEANING, "carla cannot do waste_disposal: people do the kinds that"),
        ("carla", "battery_charging", "people do the kinds that auditors judge"),
        ("organization", CLEANING, "sells battery_charging at its dock"),
        ("oracle", "dusting", "the oracle only judges work"),
    ],
)
def test_nobody_offers_what_they_cannot_do(dao: Dao, who: str, kind: str, why: str) -> None:
    dao.command("organization", "allow_kind", kind="dusting", judge="auditor")
    before = dao.state("services"), dao.balances()
    with pytest.raises(RemoteError) as refused:
        dao.command(who, "register_service", kind=kind, price_iec="1")
    assert (refused.value.code, why in refused.value.message) == ("cannot_do", True), refused.value
    assert (dao.state("services"), dao.balances()) == before


def test_a_kind_is_offered_once_by_each_who_does_it_even_by_twenty_requests_at_once(dao: Dao) -> None:
    dao.command("organization", "allow_kind", kind="dusting", judge="auditor")
    offer = {"kind": "dusting", "price_iec": "3"}

    def ask(_number: int) -> str:
        try:
            return str(dao.command("carla", "register_service", **offer)["service_id"])
        except RemoteError as error:
            return error.code

    with ThreadPoolExecutor(max_workers=20) as askers:
        answers = list(askers.map(ask, range(20)))
    assert sorted(answers)[1:] == ["already_offered"] * 19
    (service,) = dao.state("services", provider="carla", kind="dusting")["services"]
    with pytest.raises(RemoteError) as refused:
        dao.command("carla", "register_service", **offer)
    assert refused.value.message.startswith(f"carla offers dusting already, as service {service['id']}")
    # Withdrawn, it may be offered again; the same request again is the same offer.
    dao.command("carla", "update_service", service_id=service["id"], state="retired")
    again = [
        dao.command("carla", "register_service", **offer, request_id="again")["service_id"] for _ in range(2)
    ]
    assert again[0] == again[1] > service["id"]
    dao.command("carla", "update_service", service_id=again[0], state="retired")


@pytest.mark.long
def test_what_cannot_be_done_is_given_back_at_once_without_a_proof_and_the_next_gets_it(dao: Dao) -> None:
    """The contracts let a key offer anything; the bridge does not see who uses it elsewhere."""
    dao.command("organization", "allow_kind", kind="dusting", judge="auditor")
    w3, robot = Web3(Web3.HTTPProvider(dao.site.chain.url)), wallets.load(dao.site, "panther1")
    dao.set_clock(w3.eth.get_block("pending")["timestamp"] + 1)
    offer = dao.client().calls.register_service("dusting", 10**18, 0, False, "a robot that dusts")
    fees = {"gas": 1_000_000, "maxFeePerGas": 10**10, "maxPriorityFeePerGas": 10**9, "value": 0}
    about = {"chainId": w3.eth.chain_id, "nonce": w3.eth.get_transaction_count(robot.address)}
    signed = robot.sign_transaction({"to": offer.to, "data": offer.data, "type": 2, **fees, **about})
    w3.eth.wait_for_transaction_receipt(w3.eth.send_raw_transaction(signed.raw_transaction))

    task_id = dao.post("10", kind="dusting", params={}, max_attempts=4, execution_window_s=3600)
    dao.wait_for(lambda: "TaskRequeued" in dao.names_of(task_id), "what the robot gives back")
    (service,) = dao.state("services", provider="panther1", kind="dusting")["services"]
    assert (service["state"], service["rejected"], service["expired"]) == ("paused", 0, 0)
    given_back = dao.task(task_id)
    assert (given_back["verdict"], given_back["proof_sha256"]) == ("abandoned", None)
    assert any("panther1 cannot do dusting" in one for one in dao.running.status("bridge").warnings)

    with pytest.raises(RemoteError) as refused:
        dao.command("panther1", "update_service", service_id=service["id"], state="active")
    assert refused.value.code == "cannot_do"
    carlas = dao.command("carla", "register_service", kind="dusting", price_iec="3")["service_id"]
    dao.wait_for(lambda: dao.names_of(task_id).count("TaskAssigned") == 2, "the next assignment")
    task = Task.model_validate(dao.task(task_id))
    assert (task.state, task.executor_name, task.attempt) == ("assigned", "carla", 2)
    assert task.accepted is False, "nobody can check such a task before it is assigned"
    dao.set_clock(task.grace_ends_s + 2)
    dao.wait_for(lambda: len(dao.task(task_id)["passed"]) == 2, "the end of the grace period")
    task = Task.model_validate(dao.task(task_id))
    assert [one.provider_name for one in task.passed] == ["panther1", "carla"]
    assert (task.state, task.attempt, task.attempts_counted) == ("open", 2, 0), "nobody has it a second time"

    def carla_offers() -> queries.Offer:
        (offered,) = [
            one for one in dao.state("services", provider="carla")["services"] if one["id"] == carlas
        ]
        return queries.Offer.model_validate(offered)

    rests = carla_offers()
    assert rests.stood_back and not rests.proven and rests.expired == 0
    assert rests.rests_until is not None and rests.bond_locked_until is not None
    dao.command("organization", "cancel_task", task_id=task_id)
    dao.set_clock(rests.rests_until + 1)
    dao.wait_for(lambda: carla_offers().place > 0, "the end of carla's rest")
    task_id = dao.post("10", kind="dusting", params={}, execution_window_s=3600)
    dao.command("carla", "accept_task", task_id=task_id, attempt=1)
    dao.wait_for(lambda: dao.task(task_id)["accepted"], "carla's consent")
    dao.prove(task_id, "carla")
    dao.judge(task_id, accepted=True, judge="organization")
    rested = carla_offers()
    assert rested.rests_until is None
    assert rested.bond_locked_until == rests.bond_locked_until, "one accepted proof frees no bond early"
    for who, number in (("carla", carlas), ("panther1", service["id"])):
        dao.command(who, "update_service", service_id=number, state="retired")


@pytest.mark.long
def test_the_organization_sets_its_terms_and_its_members(dao: Dao) -> None:
    for policy in ("lowest_price", "highest_reputation", "first_come"):
        dao.command("organization", "set_policy", policy=policy)
        assert dao.state("organization")["policy"] == policy
    dao.command("organization", "allow_kind", kind="sweeping", judge="auditor")
    dao.command("organization", "set_terms", bond_iec="50", penalty_iec="20", max_failures=2)
    terms = {"bond_iec": "50", "penalty_iec": "20", "max_failures": 2}
    assert dao.state("organization")["terms"] == terms
    dao.command("organization", "transfer", to="carla", amount_iec="100")
    before = dao.balances()
    service_id = dao.command("carla", "register_service", kind="sweeping", price_iec="10")["service_id"]
    assert dao.balances()["carla"] == before["carla"] - 50
    for _ in range(2):
        task_id = dao.post("10", kind="sweeping", params={}, max_attempts=1)
        dao.prove(task_id, "carla")
        dao.judge(task_id, accepted=False, reason="dusty", judge="organization")
    (service,) = dao.state("services", kind="sweeping")["services"]
    assert (service["state"], service["bond_iec"], service["failures"]) == ("suspended", "10", 2)
    reasons = [one["reason"] for one in dao.state("transfers", account="carla", limit=3)["transfers"]]
    assert "bond" in reasons
    penalties = dao.state("transfers", task_id=task_id, account="organization")["transfers"]
    assert {one["reason"]: one["change_iec"] for one in penalties}["penalty"] == "20"
    assert_index_equals_contracts(dao)
    dao.set_clock(service["bond_locked_until"] + 1)
    dao.command("carla", "update_service", service_id=service_id, state="retired")
    assert dao.balances() == {
        **before,
        "organization": before["organization"] + 40,
        "carla": before["carla"] - 40,
    }
    dao.command("organization", "set_terms")
    dao.command("organization", "set_members_only", enabled=True)
    dao.command("organization", "admit", account="panther1")
    people = {one["name"]: one["member"] for one in dao.state("participants")["participants"]}
    assert dao.state("organization")["members_only"] and people["panther1"]
    with pytest.raises(RemoteError) as refused:
        dao.command("carla", "register_service", kind="sweeping", price_iec="10")
    assert refused.value.code == "not_member"
    dao.command("organization", "dismiss", account="panther1")
    dao.command("organization", "set_members_only", enabled=False)
    dao.command("organization", "suspend_provider", account="carla")
    assert [one["name"] for one in dao.state("organization")["suspended_providers"]] == ["carla"]
    with pytest.raises(RemoteError) as refused:
        dao.command("carla", "register_service", kind="sweeping", price_iec="10")
    assert refused.value.code == "provider_is_suspended"
    dao.command("organization", "reinstate_provider", account="carla")
    assert not dao.state("organization")["suspended_providers"]
    dao.command("organization", "grant_role", role="auditor", account="panther1")
    auditors = {one["name"] for one in dao.state("organization")["roles"]["AUDITOR_ROLE"]}
    assert auditors == {"organization", "panther1"}
    dao.command("organization", "revoke_role", role="auditor", account="panther1")
    assert_index_equals_contracts(dao)


@pytest.fixture
def planted_key(site_path: Path) -> str:
    """A provider's key, which is in the address of the site's node."""
    key, url = "planted-key-4711", Site.load(site_path).chain.url
    with_key = url.replace("//", f"//dao:{key}@") + f"/?apikey={key}"
    site_path.write_text(site_path.read_text().replace(url, with_key))
    return key


def outputs(running: RunningSite, *commands: Sequence[str]) -> Iterator[str]:
    """What bridge, `rodeo` with these commands, and all logs tell now."""
    status = running.status("bridge")
    yield status.model_dump_json()
    yield readyz(status.metrics_url)[1]
    with urllib.request.urlopen(f"{status.metrics_url}/metrics") as metrics:
        yield metrics.read().decode()
    for query in vars(queries).values():
        if isinstance(query, queries.Query):
            try:
                yield json.dumps(Dao(running).state(query.what))
            except RemoteError as error:
                yield str(error)
    for asked in commands:
        done = rodeo(*asked, "--site", str(running.path), env=dict(os.environ), timeout_s=HANG_S)
        yield done.stdout + done.stderr
    for log in (running.site.data_dir / "logs").iterdir():
        yield log.read_text()


@pytest.mark.long
def test_without_contracts_the_bridge_says_what_is_missing_and_tells_nobody_the_nodes_key(
    planted_key: str, running: RunningSite
) -> None:
    assert planted_key in running.site.chain.url
    running.start("router", "bridge", ready=False)
    seen: list[str] = []
    no_node, no_contracts = threading.Event(), threading.Event()

    def on_status(_key: str, data: dict[str, Any]) -> None:
        status = Status.model_validate(data)
        assert not status.ready
        seen.append(status.reason)
        if status.reason.startswith(f"no node at {running.site.chain.shown_url}"):
            no_node.set()
        if status.reason == "deployment record missing: run `rodeo site prepare`":
            no_contracts.set()

    subscriber = running.bus.subscribe_json(f"rodeo/{running.site.org}/status/bridge", on_status)
    assert no_node.wait(HANG_S), seen
    with pytest.raises(RemoteError) as refused:
        Dao(running).state("tasks")
    assert refused.value.code == "bridge_not_ready"
    commands = (("status", "--json"), ("organization", "list"), ("site", "wallets", "--json"))
    assert not [text for text in outputs(running, *commands) if planted_key in text]
    running.start("chain", ready=False)
    assert no_contracts.wait(HANG_S), seen
    subscriber.undeclare()
    running.deploy_contracts()
    running.wait_ready("bridge")
    assert not [text for text in outputs(running) if planted_key in text]


@pytest.mark.long
def test_a_killed_bridge_goes_on_where_it_was(own_dao: Dao) -> None:
    dao = own_dao
    task_id = dao.post()
    dao.running.kill("bridge")
    dao.running.start("bridge")
    dao.prove(task_id)
    dao.running.kill("bridge")
    dao.running.start("bridge")
    dao.judge(task_id, accepted=True)
    dao.catch_up()
    heard = [event.model_dump() for event in dao.events]
    assert [event["seq"] for event in heard] == list(range(1, len(heard) + 1))
    assert dao.state("events")["events"] == [event.model_dump(mode="json") for event in dao.events]
    assert_index_equals_contracts(dao)


@pytest.mark.long
def test_a_killed_chain_comes_back_under_the_same_bridge(own_dao: Dao) -> None:
    dao = own_dao
    task_id = dao.post()
    dao.running.kill("chain")
    with pytest.raises(RemoteError) as refused:
        dao.prove(task_id)
    assert refused.value.code in ("chain_unavailable", "bridge_not_ready")
    dao.running.start("chain", ready=False)
    retried(
        dao,
        "panther1",
        "submit_proof",
        task_id=task_id,
        attempt=1,
        proof_sha256="0x" + "a" * 64,
        proof_uri=f"{dao.site.store_url}/{'a' * 64}.mcap",
        request_id=f"the proof of {task_id}",
    )
    dao.judge(task_id, accepted=True)
    assert dao.task(task_id)["state"] == "settled"
    assert_index_equals_contracts(dao)


def test_a_killed_router_loses_no_event(own_dao: Dao) -> None:
    dao = own_dao
    task_id = dao.post()
    url = dao.running.status("bridge").metrics_url
    dao.running.kill("router")
    wait_until(lambda: readyz(url)[0] == 503, "it is ready without a router")
    assert "no router" in readyz(url)[1]
    dao.running.start("router", ready=False)
    sha256 = "a" * 64
    retried(
        dao,
        "panther1",
        "submit_proof",
        task_id=task_id,
        attempt=1,
        proof_sha256="0x" + sha256,
        proof_uri=f"{dao.site.store_url}/{sha256}.mcap",
        request_id=f"the proof of {task_id}",
    )
    dao.judge(task_id, accepted=True)
    dao.catch_up()
    assert dao.names_of(task_id)[-1] == "TaskSettled"
    assert [event.seq for event in dao.events] == list(range(1, len(dao.events) + 1))
    assert readyz(url)[0] == 200
    assert events_from_the_beginning(dao) == [event.model_dump() for event in dao.events]


@pytest.mark.long
def test_an_index_that_was_lost_is_rebuilt_from_the_chain(own_dao: Dao) -> None:
    dao = own_dao
    task_id = dao.post()
    dao.prove(task_id)
    dao.judge(task_id, accepted=True)
    before = (dao.state("events"), dao.state("tasks"), dao.state("services"), dao.state("wallets"))
    dao.running.kill("bridge")
    for path in Path(dao.site.data_dir / "bridge").rglob("index.sqlite*"):
        path.unlink()
    dao.running.start("bridge")
    assert (dao.state("events"), dao.state("tasks"), dao.state("services"), dao.state("wallets")) == before


@pytest.mark.long
def test_a_value_that_was_changed_in_the_index_is_not_told_for_truth(own_dao: Dao) -> None:
    dao = own_dao
    (path,) = Path(dao.site.data_dir / "bridge").rglob("index.sqlite")
    before = (dao.state("events"), dao.state("wallets"))

    dao.running.kill("bridge")
    connection = sqlite3.connect(path)
    with connection:
        connection.execute("update balances set balance = '9999000000000000000000'")
    connection.close()
    dao.running.start("bridge")
    assert (dao.state("events"), dao.state("wallets")) == before
    assert dao.running.log("bridge").count("rebuilding the index from the chain") == 1
