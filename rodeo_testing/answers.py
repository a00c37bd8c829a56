"""Complete answers of the bridge's index, for fakes of it; a test sets `changes`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rodeo.bus.queries import A, Query

ADDRESS = "0x" + "99" * 20
CONTRACTS = {
    "Organization": "0x" + "22" * 20,
    "TaskManager": "0x" + "11" * 20,
    "ServiceManager": "0x" + "05" * 20,
    "OracleCommittee": "0x" + "06" * 20,
    "OracleJudge": "0x" + "07" * 20,
    "AuditorJudge": "0x" + "08" * 20,
    "DeviceRegistry": "0x" + "09" * 20,
}


def chain(**changes: Any) -> dict[str, Any]:
    return {
        "chain_id": 31337,
        "genesis_hash": "0x" + "01" * 32,
        "url": "http://127.0.0.1:8545",
        "head": 7,
        "time_s": 0.0,
        "contracts": CONTRACTS,
        "organization": CONTRACTS["Organization"],
        "kinds": [],
        "last_seq": 0,
        "stores": [],
        **changes,
    }


def organization(audited: Sequence[str] = (), measured: Sequence[str] = ()) -> dict[str, Any]:
    """`audited`: kinds that auditors judge, `measured`: those that the oracle does."""
    windows: dict[str, Any] = {
        "allowed": True,
        "min_window_s": 600,
        "max_window_s": 604_800,
        "grace_s": 180,
        "reference_price_iec": "100",
        "min_verdict_window_s": 900,
        "max_verdict_window_s": 604_800,
    }
    windows |= {"number": 1, "removed": False, "audit_window_s": 0, "rules_sha256": []}
    windows |= {"judges_window_s": 60, "max_case_s": 2_592_000}
    windows |= {"votes": 0, "panel": 0, "rotation_s": 0, "seats": [], "judge_stake_iec": "0"}
    kinds = [(kind, "auditor") for kind in audited] + [(kind, "oracle") for kind in measured]
    return {
        "address": ADDRESS,
        "treasury_iec": "0",
        "policy": "first_come",
        "kinds": [{"kind": kind, "judge": judge, **windows} for kind, judge in kinds],
        "terms": {"bond_iec": "0", "penalty_iec": "0", "max_failures": 0},
        "members_only": False,
        "paused_until_s": 0,
        "decided_by": "administrator",
        "delay_s": 0,
        "judges": [],
        "committees": [],
        "auditors": "none",
        "voids": {},
        "many_voids": False,
        "suspended_providers": [],
        "budgets": {},
        "roles": {},
        "contracts": CONTRACTS,
    }


def events(of: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {"events": list(of), "last_seq": len(of), "chain": ""}


def wallets(addresses: Mapping[str, str]) -> dict[str, Any]:
    paid = {"payout": None, "payout_name": None}
    return {
        "wallets": [
            {"name": name, "address": address, "balance_iec": "0", "owed_iec": "0", **paid}
            for name, address in addresses.items()
        ],
        "supply_iec": "0",
    }


def roots(posted: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
    where = {"block": 1, "time_s": 0.0, "tx_hash": "0x"}
    return {"roots": [{**where, **one} for one in posted], "total": len(posted)}


def transaction(**changes: Any) -> dict[str, Any]:
    cost = dict.fromkeys(("sender", "sender_name", "gas_used", "gas_price_wei", "fee_wei"))
    return {"tx_hash": "0x", "block": 1, "time_s": 0.0, "events": [], "task_ids": [], **cost, **changes}


def answered(query: Query[A], table: Mapping[str, dict[str, Any]]) -> A:
    """The answer of `table` to the question, as the caller gets it."""
    return query.answer.model_validate(table[query.what])
