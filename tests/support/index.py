"""The bridge's index held against the contracts: every field that a view of theirs and an answer share."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict
from decimal import Decimal
from enum import Enum
from typing import Any

from rodeo.bus.messages import Task
from rodeo.chain.client import ChainClient
from rodeo.chain.contracts.abi import Hire, Revocation
from rodeo.chain.contracts.types import ZERO_ADDRESS, Policy, Role
from rodeo.money.currency import IEC
from tests.support.views import view

_PAGE = 500


def index_differences(state: Callable[..., dict[str, Any]], client: ChainClient) -> list[str]:
    """What they do not agree on, a line each; `state(what, **parameters)` asks the index."""
    found = _Differences()
    services = {one["id"]: one for one in _pages(state, "services")}
    found.check("services", sorted(services), list(range(1, client.services.count() + 1)))
    for service_id, service in services.items():
        what, kept_service = f"service {service_id}", client.services.service(service_id)
        found.check_record(what, service, kept_service, without=("max_voids", "proven"))
        found.check(f"{what}: voids", service["max_void_percent"], kept_service.max_voids)
    tasks = {task["id"]: task for task in _pages(state, "tasks")}
    found.check("tasks", sorted(tasks), list(range(1, client.tasks.count() + 1)))
    for task_id, indexed in tasks.items():
        Task.model_validate(indexed)
        what, kept = f"task {task_id}", client.tasks.task(task_id)
        # The contracts keep the deadline that runs, and of the proof only one that waits.
        apart = {"deadline", "case_end", "kind_id", "proof_hash", "price", "hired", "service_id", "provider"}
        found.check_record(what, indexed, kept, without=apart)
        named = indexed["requested_service_id"]
        provider = indexed["requested_provider"]
        hired = Hire.SERVICE if named else Hire.PROVIDER if provider else Hire.NONE
        found.check(f"{what}: hired", hired, kept.hired)
        found.check(f"{what}: provider", provider or ZERO_ADDRESS, kept.provider)
        found.check(f"{what}: service", indexed["service_id"] or named or 0, kept.service_id)
        waits = indexed["state"] in ("submitted", "ruled")
        running = "verdict_deadline" if waits else "execution_deadline"
        runs = waits or indexed["state"] == "assigned"
        found.check(f"{what}: deadline", indexed[running] if runs else 0, kept.deadline)
        found.check(f"{what}: case end", indexed["case_end"] if waits else 0, kept.case_end)
        if indexed["standing"] is not None:
            found.check_record(
                f"{what}: ruling",
                indexed["standing"],
                client.tasks.standing(task_id),
                without=("proof_hash", "penalty", "after_removal"),
            )
        waiting = indexed["proof_sha256"] if waits else "0x" + "00" * 32
        found.check(f"{what}: proof", waiting, "0x" + kept.proof_hash.hex())
        found.check(f"{what}: price", Decimal(indexed["price_iec"] or 0), IEC.from_units(kept.price))
        provider = services[indexed["service_id"]]["provider"] if indexed["service_id"] else None
        found.check(f"{what}: executor", indexed["executor"], provider)
        passed = [(services[number]["provider"], gave_up) for number, gave_up in client.tasks.passed(task_id)]
        told = [(one["provider"], one["gave_up"]) for one in reversed(indexed["passed"])]
        found.check(f"{what}: passed", told, passed)
    _compare_money_and_rules(found, state, client)
    return found


def _compare_money_and_rules(
    found: _Differences, state: Callable[..., dict[str, Any]], client: ChainClient
) -> None:
    wallets = state("wallets")
    found.check("supply", Decimal(wallets["supply_iec"]), IEC.from_units(client.token.total_supply()))
    for entry in wallets["wallets"]:
        found.check_iec(
            f"{entry['name']}: balance", entry["balance_iec"], client.token.balance(entry["address"])
        )
        found.check_iec(
            f"{entry['name']}: owed", entry["owed_iec"], client.tasks.pending_payments(entry["address"])
        )
        payout = entry["payout"] or entry["address"]
        paid_to = view(client, "Providers", "payoutOf", entry["address"])
        found.check(f"{entry['name']}: payout", payout, paid_to)
    for device in state("devices")["devices"]:
        what, kept = f"device {device['address']}", client.devices.device(device["address"])
        found.check_record(what, device, kept, without={"registered_at", "revoked_at", "revocation"})
        found.check(f"{what}: registered", device["registered"], kept.registered_at)
        found.check(f"{what}: revoked", device["revoked"] or 0, kept.revoked_at)
        because = Revocation[(device["revoked_because"] or "none").upper()]
        found.check(f"{what}: revoked because", because, kept.revocation)
    rules = state("organization")
    policies = {client.deployment.contracts[one]: one.name.lower() for one in Policy}
    found.check("policy", rules["policy"], policies[client.rules.policy()])
    named = {client.deployment.contracts["AuditorJudge"]: "auditor", ZERO_ADDRESS: "none"}
    found.check("auditors", rules["auditors"], named.get(client.judges.auditors(), client.judges.auditors()))
    found.check("members only", rules["members_only"], view(client, "Organization", "membersOnly"))
    found.check_record("terms", rules["terms"], client.rules.terms())
    for kind in rules["kinds"]:
        found.check_record(f"kind {kind['kind']}", kind, client.rules.kind(kind["kind"]))
        removed = bool(kind["number"]) and view(client, "TaskManager", "isRemoved", kind["number"])
        found.check(f"kind {kind['kind']}: removed", kind["removed"], removed)
    holders = {one["address"] for held in rules["roles"].values() for one in held}
    for role in Role:
        held = {one["address"] for one in rules["roles"].get(role, [])}
        found.check(f"{role}", held, {address for address in holders if client.rules.has_role(role, address)})
    for person in state("participants")["participants"]:
        member = client.rules.has_role(Role.MEMBER, person["address"])
        found.check(f"{person['name']}: member", person["member"], member)
        address, locked = person["address"], person["bond_locked_until"] or 0
        found.check(f"{person['name']}: proven", person["proven"], client.services.is_proven(address))
        found.check(f"{person['name']}: bonds", locked, view(client, "Providers", "lockedUntil", address))
        found.check_iec(person["name"], person["balance_iec"], client.token.balance(person["address"]))


class _Differences(list[str]):
    def check(self, what: str, indexed: Any, kept: Any) -> None:
        if indexed != kept:
            self.append(f"{what}: {indexed!r} in the index, {kept!r} in the contracts")

    def check_iec(self, what: str, indexed: str, kept_wei: int) -> None:
        self.check(what, indexed, f"{IEC.from_units(kept_wei):f}")

    def check_record(
        self, what: str, indexed: dict[str, Any], kept: Any, without: Collection[str] = ()
    ) -> None:
        """Each field of a contract's record, as the index names and writes it."""
        for name, value in asdict(kept).items():
            if name in without:
                continue
            if f"{name}_iec" in indexed:
                self.check_iec(f"{what}: {name}", indexed[f"{name}_iec"], value)
            elif f"{name}_s" in indexed:
                self.check(f"{what}: {name}", indexed[f"{name}_s"], value)
            elif isinstance(value, Enum):
                self.check(f"{what}: {name}", indexed[name], value.name.lower())
            else:
                self.check(f"{what}: {name}", indexed[name] or 0, value)


def _pages(state: Callable[..., dict[str, Any]], what: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    while page := state(what, limit=_PAGE, offset=len(rows))[what]:
        rows += page
    return rows
