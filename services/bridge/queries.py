"""`state/<what>`: answers from the index."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

from rodeo.bus.messages import Message, TaskState
from rodeo.bus.queries import (
    Account,
    EventRange,
    HistoryRange,
    RootFilters,
    ServiceFilters,
    TaskFilters,
    TransactionFilters,
    TransferFilters,
)
from rodeo.bus.session import Request, validate
from rodeo.chain.client import ChainClient
from rodeo.chain.contracts.types import Role
from rodeo.chain.reputation import Work
from rodeo.commands.errors import UnknownTask
from rodeo.judging.verdicts import LAST_RULINGS, counted_voids
from rodeo.money.currency import Currency
from rodeo.text.redaction import shown
from rodeo.text.strict_json import Json
from services.bridge.chain import Chain
from services.bridge.errors import UnknownQuery
from services.bridge.names import ORGANIZATION, Names
from services.bridge.organization import OrganizationQueries
from services.bridge.reading import Page

MAX_BUCKETS = 2_000


Answering = Callable[[Request], Json]


class _States(Message):
    states: list[TaskState]


class Queries:
    """Answers questions about the organization."""

    def __init__(
        self,
        chain: Chain,
        names: Names,
        client: ChainClient,
        url: str,
        stores: list[str],
        others: Mapping[str, Answering] = {},
    ) -> None:
        """`stores` are the prefixes of the URIs that a proof may have; `others` answer what is not on the
        chain."""
        self._index = chain.index
        self._names = names
        self._deployment = chain.deployment
        self._currency = chain.deployment.currency
        self._iec = self._currency.text
        self._client = client
        self._node = chain.node
        self._url = url
        self._stores = stores
        self._table: Mapping[str, Answering] = {
            "tasks": self._tasks,
            "services": self._services,
            "participants": self._participants,
            "wallets": self._wallets,
            "wallet": self._wallet,
            "transfers": self._transfers,
            "transactions": self._transactions,
            "history": self._history,
            "devices": self._devices,
            "roots": self._roots,
            **OrganizationQueries(chain, names, client, self._balances).table(),
            "chain": self._chain,
            "events": self._events,
            **others,
        }

    def answer(self, what: str, request: Request) -> Json:
        """The answer to `state/<what>`. Raises RequestError."""
        if what.startswith("task/"):
            return self._task(what.removeprefix("task/"))
        if what not in self._table:
            raise UnknownQuery("no such query", what=what, known=[*self._table, "task/<id>"])
        return self._table[what](request)

    # -- tasks and services --------------------------------------------------------------------------------

    def _tasks(self, request: Request) -> Json:
        filters = validate(TaskFilters, request.parameters)
        wanted = filters.model_dump(include={"kind", "creator", "executor", "service_id"}, exclude_none=True)
        states = [] if filters.state is None else filters.state.split(",")
        rows, total = self._index.tasks.find(
            self._with_addresses(wanted, "creator", "executor"),
            Page(filters.limit, filters.offset),
            states=validate(_States, {"states": states}).states,
            text=filters.text,
            newest_first=filters.order == "newest",
        )
        numbers = self._index.rules.numbers()
        return {"tasks": [self._task_json(row, numbers) for row in rows], "total": total}

    def _task(self, text: str) -> Json:
        # 18 digits fit into an Id.
        row = self._index.tasks.get(int(text)) if text.isdecimal() and len(text) <= 18 else None
        if row is None:
            raise UnknownTask("no such task", task_id=text)
        return self._task_json(row, self._index.rules.numbers())

    def _task_json(self, row: Mapping[str, Any], numbers: Mapping[int, Mapping[str, Any]]) -> Json:
        who = self._names.judge_of(numbers.get(row["number"]))
        judge = {"judge": who["judge"], "judge_removed": who["removed"]}
        return task_json(row, self._names, self._currency) | judge

    def _services(self, request: Request) -> Json:
        filters = validate(ServiceFilters, request.parameters)
        wanted = filters.model_dump(exclude={"limit", "offset"}, exclude_none=True)
        rows, total = self._index.services.find(
            self._with_addresses(wanted, "provider"), Page(filters.limit, filters.offset)
        )
        providers, now_s = self._index.services.providers(), self._index.position.block_time_s
        numbers = {row["kind"]: row["number"] for row in self._index.rules.all_kinds()}
        amounts = ("price", "bond", "penalty", "set_aside")
        return {
            "services": [
                {
                    **{key: value for key, value in row.items() if key not in (*amounts, *_KEPT_OF_SERVICE)},
                    **{f"{key}_iec": self._iec(row[key]) for key in amounts},
                    "agrees": row["number"] == numbers.get(row["kind"]),
                    "failures": providers[row["provider"]]["failures"],
                    "asleep_until": providers[row["provider"]]["asleep_until"],
                    "stood_back": row["state"] == "active" and row["task_id"] is None and not row["place"],
                    **self._known_json(row["provider"], providers),
                    "provider_name": self._names.name(row["provider"]),
                    "reputation": _reputation(providers[row["provider"]], now_s, self._currency),
                }
                for row in rows
            ],
            "total": total,
        }

    # -- people and money ----------------------------------------------------------------------------------

    def _participants(self, _request: Request) -> Json:
        roles = self._index.rules.roles()
        providers = self._index.services.providers()
        created, executed = self._index.tasks.counts("creator"), self._index.tasks.counts("executor")
        members, voids = roles.get(Role.MEMBER, []), self._index.tasks.voids()
        recent = self._index.tasks.recent_voids(LAST_RULINGS)
        named = self._names.addresses
        strangers = sorted((created.keys() | executed.keys()) - set(named.values()))
        people: list[tuple[str | None, str]] = [*named.items(), *((None, one) for one in strangers)]
        balances = self._balances([address for _, address in people])
        return {
            "participants": [
                {
                    "name": name,
                    "address": address,
                    "role": None if name is None else self._names.role(name),
                    "roles_on_chain": sorted(role for role, held in roles.items() if address in held),
                    "balance_iec": self._iec(balances.get(address, 0)),
                    "created": created.get(address, {}),
                    "executed": executed.get(address, {}),
                    "member": address in members,
                    "voids": voids.get(address, {}),
                    "many_voids": bool(counted_voids(*recent.get(address, (0, {})), of_a_creator=True)),
                    **self._payout_json(providers.get(address, {}).get("payout")),
                    **self._known_json(address, providers),
                }
                for name, address in people
            ]
        }

    def _known_json(self, address: str, providers: Mapping[str, Mapping[str, Any]]) -> Json:
        """`rodeo.bus.queries.Known`."""
        known = providers.get(address, {})
        is_organization = address == self._names.addresses[ORGANIZATION]
        vouched = bool(known.get("vouched"))
        return {
            "proven": is_organization or vouched or bool(known.get("earned")),
            "vouched": vouched,
            "rests_until": known.get("rests_until"),
            "bond_locked_until": known.get("bond_locked_until"),
        }

    def _wallets(self, _request: Request) -> Json:
        addresses = self._names.addresses
        balances = self._balances([*addresses.values()])
        owed, payouts = self._index.money.owed(), self._index.services.payouts()
        return {
            "wallets": [
                {
                    "name": name,
                    "address": address,
                    "balance_iec": self._iec(balances.get(address, 0)),
                    "owed_iec": self._iec(owed.get(address, 0)),
                    **self._payout_json(payouts.get(address)),
                }
                for name, address in addresses.items()
            ],
            "supply_iec": self._iec(self._supply()),
        }

    def _wallet(self, request: Request) -> Json:
        address = self._names.address(validate(Account, request.parameters).account)
        return {
            "name": self._names.name(address),
            "address": address,
            "balance_iec": self._iec(self._balances([address])[address]),
            "in_escrow_iec": self._iec(self._index.tasks.in_escrow(address)),
            **self._payout_json(self._index.services.payouts().get(address)),
        }

    def _balances(self, addresses: Sequence[str]) -> dict[str, int]:
        """What these accounts own, wei. Of a token that was there before the organization the events say only
        how balances have changed since, so that the node is asked. Raises ChainUnavailable."""
        if not self._deployment.is_token_foreign:
            known = self._index.money.balances()
            return {address: known.get(address, 0) for address in addresses}
        return {address: self._client.token.balance(address) for address in addresses}

    def _supply(self) -> int:
        if self._deployment.is_token_foreign:
            return self._client.token.total_supply()
        return sum(self._index.money.balances().values())

    def _payout_json(self, payout: str | None) -> Json:
        return {"payout": payout, "payout_name": self._names.name(payout)}

    def _transfers(self, request: Request) -> Json:
        wanted = validate(TransferFilters, request.parameters)
        account = None if wanted.account is None else self._names.address(wanted.account)
        rows, total = self._index.money.transfers(
            account, wanted.task_id, wanted.first_s, wanted.last_s, Page(wanted.limit, wanted.offset)
        )
        return {"transfers": [self._transfer_json(row, account) for row in rows], "total": total}

    def _transfer_json(self, row: Mapping[str, Any], account: str | None) -> Json:
        transfer = {
            **{
                key: row[key]
                for key in ("seq", "block", "time_s", "tx_hash", "sender", "to", "task_id", "reason")
            },
            "sender_name": self._names.name(row["sender"]),
            "to_name": self._names.name(row["to"]),
            "amount_iec": self._iec(row["amount"]),
        }
        if account is not None:
            received = row["to"] == account
            transfer |= {
                "change_iec": self._iec(row["amount"] * (received - (row["sender"] == account))),
                # See _balances.
                "balance_iec": None
                if self._deployment.is_token_foreign
                else self._iec(row["to_balance"] if received else row["sender_balance"]),
            }
        return transfer

    def _transactions(self, request: Request) -> Json:
        wanted = validate(TransactionFilters, request.parameters)
        page = Page(wanted.limit, wanted.offset)
        rows, total = self._index.money.transactions(wanted.task_id, page)
        if missing := [row["tx_hash"] for row in rows if row["sender"] is None]:
            self._index.money.keep_receipts(self._receipts(missing))
            rows, total = self._index.money.transactions(wanted.task_id, page)
        return {"transactions": [transaction_json(row, self._names) for row in rows], "total": total}

    def _receipts(self, hashes: Iterable[str]) -> list[Json]:
        """What the node says that the transactions cost, where it says all of that."""
        found = self._node.batch([("eth_getTransactionReceipt", [tx_hash]) for tx_hash in hashes])
        return [
            {
                "tx_hash": receipt["transactionHash"],
                "sender": self._names.address(receipt["from"]),
                "gas_used": int(receipt["gasUsed"], 16),
                "gas_price": int(receipt["effectiveGasPrice"], 16),
            }
            for receipt in found
            if isinstance(receipt, dict) and receipt.get("from") and receipt.get("effectiveGasPrice")
        ]

    def _history(self, request: Request) -> Json:
        """Numbers per span of time, for charts. Spans without any are left out."""
        wanted = validate(HistoryRange, request.parameters)
        last_s = self._index.position.block_time_s if wanted.last_s is None else wanted.last_s
        buckets: dict[int, dict[str, Any]] = {}

        def bucket(time_s: float) -> dict[str, Any]:
            start_s = int(time_s // wanted.bucket_s * wanted.bucket_s)
            return buckets.setdefault(
                start_s,
                {
                    "start_s": start_s,
                    **dict.fromkeys(("registered", "settled", "failed", "cancelled", "paid"), 0),
                    "execution_s": [],
                    "verification_s": [],
                },
            )

        for task in self._index.tasks.times(wanted.first_s, last_s):
            if wanted.first_s <= task["registered"] <= last_s:
                bucket(task["registered"])["registered"] += 1
            if task["ended"] is not None and wanted.first_s <= task["ended"] <= last_s:
                ended = bucket(task["ended"])
                ended[task["state"]] += 1
                ended["paid"] += task["paid"]
                if task["settled"] is not None:
                    ended["execution_s"].append(task["proof_submitted"] - task["assigned"])
                    ended["verification_s"].append(task["settled"] - task["proof_submitted"])
        newest = sorted(buckets.values(), key=lambda one: one["start_s"])[-MAX_BUCKETS:]
        return {
            "buckets": [
                {
                    **{
                        key: value
                        for key, value in one.items()
                        if not isinstance(value, list) and key != "paid"
                    },
                    "paid_iec": self._iec(one["paid"]),
                    "mean_execution_s": _mean(one["execution_s"]),
                    "mean_verification_s": _mean(one["verification_s"]),
                }
                for one in newest
            ],
            "bucket_s": wanted.bucket_s,
        }

    # -- the organization and its chain --------------------------------------------------------------------

    def _devices(self, _request: Request) -> Json:
        return {
            "devices": [
                {**row, "owner_name": self._names.name(row["owner"])} for row in self._index.rules.devices()
            ]
        }

    def _roots(self, request: Request) -> Json:
        wanted = validate(RootFilters, request.parameters)
        device = None if wanted.device is None else self._names.address(wanted.device)
        rows, total = self._index.rules.roots(device, Page(wanted.limit, wanted.offset))
        return {"roots": rows, "total": total}

    def _chain(self, _request: Request) -> Json:
        position = self._index.position
        return {
            "chain_id": self._deployment.chain_id,
            "genesis_hash": self._deployment.genesis_hash,
            "url": shown(self._url),
            "head": position.block,
            "time_s": position.block_time_s,
            "contracts": self._deployment.contracts,
            "organization": self._deployment.address("Organization"),
            "kinds": self._index.rules.kinds(),
            "last_seq": self._index.last_seq(),
            "stores": self._stores,
        }

    def _events(self, request: Request) -> Json:
        wanted = validate(EventRange, request.parameters)
        names = () if wanted.name is None else wanted.name.split(",")
        events = self._index.events_after(wanted.after, wanted.limit, names, wanted.task_id)
        return {
            "events": [event.model_dump(mode="json") for event in events],
            "last_seq": self._index.last_seq(),
            "chain": self._index.genesis_hash,
        }

    # ------------------------------------------------------------------------------------------------------

    def _with_addresses(self, wanted: dict[str, Any], *parties: str) -> dict[str, Any]:
        """Parties by their address, which is how the index knows them."""
        return {
            name: self._names.address(value) if name in parties else value for name, value in wanted.items()
        }


class Naming(Protocol):
    """Names participants."""

    def name(self, address: str | None) -> str | None:
        """None for a stranger."""


def task_json(row: Mapping[str, Any], names: Naming, currency: Currency) -> Json:
    """`rodeo.bus.messages.Task`."""
    amounts = {"reward", "price", "paid", "refunded"}
    return {
        **{key: value for key, value in row.items() if key not in {*amounts, *_KEPT_OF_TASK}},
        **{f"{key}_iec": None if row[key] is None else currency.text(row[key]) for key in sorted(amounts)},
        "creator_name": names.name(row["creator"]),
        "requested_provider_name": names.name(row["requested_provider"]),
        "executor_name": names.name(row["executor"]),
        "passed": [{**one, "provider_name": names.name(one["provider"])} for one in row["passed"]],
    }


def transaction_json(row: Mapping[str, Any], names: Names) -> Json:
    """`rodeo.bus.queries.Transaction`."""
    cost: Json = dict.fromkeys(("sender", "sender_name", "gas_used", "gas_price_wei", "fee_wei"))
    if row["sender"] is not None:
        cost = {
            "sender": row["sender"],
            "sender_name": names.key_name(row["sender"]),
            "gas_used": row["gas_used"],
            "gas_price_wei": str(row["gas_price"]),
            "fee_wei": str(row["gas_used"] * row["gas_price"]),
        }
    return {key: row[key] for key in ("tx_hash", "block", "time_s", "events", "task_ids")} | cost


_KEPT_OF_SERVICE = ("number", "waits_as_proven")
"""Columns of a service that no answer has."""

_KEPT_OF_TASK = (
    "opened",
    "ended",
    "number",
    "audit_window_s",
    "standing_until",
    "after_removal",
    "set_aside",
)
"""Columns of a task that no answer has."""


def _reputation(provider: Mapping[str, Any], time_s: float, currency: Currency) -> int:
    return Work(provider["done"], provider["failed"], provider["day"]).reputation(time_s, currency)


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None
