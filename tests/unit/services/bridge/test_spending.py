"""What each command counts against the daily limit of its wallet, and what one transaction may cost."""

from __future__ import annotations

from concurrent.futures import Future
from decimal import Decimal
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.commands import COMMANDS
from rodeo.commands.desk import Desk
from rodeo.commands.errors import DailyLimitReached
from rodeo.commands.tasks import RaiseReward
from rodeo.money.currency import ETHER, IEC
from rodeo.site.sections import WalletLimits
from services.bridge.errors import FeeTooHigh
from services.bridge.fees import GAS_HEADROOM, GAS_MARGIN, Limits, Market
from services.bridge.wallet import Wallet, parse

ALICE, BOB, COIN = ("0x" + digit * 40 for digit in "123")
FIVE = {"amount_iec": "5"}
RESCUE: dict[str, Any] = {
    "command": "rescue_tokens",
    "description": "lost",
    "request": {"token": COIN, "to": "bob"},
}

SPENDS: dict[str, list[tuple[dict[str, Any], int]]] = {
    "register_task": [({"kind": "sweeping", "reward_iec": "5"}, 5)],
    # Task 1 is open and task 2 cancelled, each with a reward of 40.
    "raise_reward": [({"task_id": 1, "reward_iec": "45"}, 5), ({"task_id": 2, "reward_iec": "45"}, 45)],
    "transfer": [({"to": "bob", **FIVE}, 5)],
    "deposit": [(FIVE, 5)],
    "withdraw": [({"to": "bob", **FIVE}, 5)],
    # Its owner, who may be anybody, has it back.
    "deposit_stake": [({"judge": "anna", **FIVE}, 5)],
    "challenge": [({"task_id": 3, "reason": "no"}, 20)],
    # The contract takes what the terms say when it is mined, up to what the command agrees to.
    "register_service": [
        ({"kind": "sweeping", "price_iec": "9"}, 30),
        ({"kind": "sweeping", "price_iec": "9", "max_bond_iec": "70"}, 70),
    ],
    "open_budget_vote": [({"recipients": ["bob"], "duration_s": 60, **FIVE}, 5)],
    "rescue_tokens": [({"token": COIN, "to": "bob"}, 8), ({"token": BOB, "to": "bob"}, 0)],
    "propose": [(RESCUE, 8)],
}
"""Command -> requests, and what each spends, IEC."""

FREE = {
    *("cancel_task", "accept_task", "abandon_task", "submit_proof", "expire_task", "match_task"),
    # Of others' escrow.
    *("rule", "post_votes", "conclude", "settle_stakes"),
    # Money that comes back, or comes in.
    *("announce_withdrawal", "withdraw_stake", "collect"),
    # What was counted when it was promised: by the proposer, or nobody where members decided.
    *("execute_proposal", "queue_proposal", "cancel_proposal", "cast_vote", "cast_budget_vote"),
    "pay_budget_share",
    # The contracts take only what the wallet's own commands say.
    "allow_payments",
    # The wallet that signed it pays; one with a daily limit signs nothing that others send.
    *("relay", "revoke_request"),
    *("update_service", "agree", "register_device", "revoke_device", "post_root"),
    *("allow_kind", "remove_judge", "retire_rules"),
    *("set_policy", "set_terms", "set_members_only", "set_budget", "pause_tasks", "resume_tasks"),
    *("admit", "dismiss", "vouch", "set_namers", "suspend_provider", "reinstate_provider", "suspend_service"),
    *("reinstate_service", "grant_role", "revoke_role", "change_judge_key", "seat_judge"),
    *("unseat_judge", "set_quorum", "set_instances", "hand_over", "set_delay"),
}
"""Commands by which nothing leaves the wallet."""

UNBOUNDED = {"set_payout"}


class Node:
    """What a wallet's commands ask of chain and index."""

    currency = IEC
    task_manager = ALICE
    deployment = SimpleNamespace(address=lambda _name: COIN, decides_by_vote=False)

    @property
    def tasks(self) -> Any:
        return SimpleNamespace(get=self._task, unaccounted=lambda: 8 * 10**18)

    @property
    def rules(self) -> Any:
        return SimpleNamespace(setting=lambda _name: {"bond_iec": "30"})

    def _task(self, task_id: int) -> Any:
        return {
            "id": task_id,
            "kind": "sweeping",
            "reward": 40 * 10**18,
            "state": {1: "open", 2: "cancelled", 3: "ruled"}[task_id],
            "dispute": {"instance": 0, "stakes_iec": ["20"]},
        }


def wallet(**limits: Any) -> Wallet:
    unused: Any = SimpleNamespace()
    node: Any = Node()
    sent: list[Any] = []

    def submit(order: Any) -> Future[Any]:
        sent.append(order.command)
        done: Future[Any] = Future()
        done.set_result({})
        return done

    checked = Limits(WalletLimits(**limits), IEC)
    queue = SimpleNamespace(limits=checked, account=None)
    orders = SimpleNamespace(wallets={"alice": queue}, submit=submit, sent=sent)
    signer = SimpleNamespace(check_spending=lambda order: checked.check_day((0, 0), order.spends, 0))
    transactions: Any = SimpleNamespace(orders=orders, signer=signer)
    names: Any = SimpleNamespace(addresses={"alice": ALICE, "bob": BOB}, payout={"alice": COIN}.get)
    desk = Desk("alice", node, node, names, unused, unused, unused, checked.has_daily_iec)
    return Wallet(desk, transactions)


def test_each_command_counts_or_is_listed_as_free() -> None:
    """Whoever adds a command decides here."""
    assert SPENDS.keys() | FREE | UNBOUNDED == COMMANDS.keys()
    assert not SPENDS.keys() & FREE


@pytest.mark.parametrize(
    ("name", "request_", "iec"),
    [(name, request, iec) for name, rows in SPENDS.items() for request, iec in rows],
)
def test_what_leaves_the_wallet_counts(name: str, request_: dict[str, Any], iec: int) -> None:
    assert parse(name, request_).spends(wallet().desk) == iec * 10**18


@pytest.mark.parametrize("name", sorted(FREE))
def test_what_costs_nothing_counts_nothing(name: str) -> None:
    assert COMMANDS[name].model_construct().spends(wallet().desk) == 0


def test_what_members_decide_is_not_their_proposers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Node.deployment, "decides_by_vote", True)
    assert parse("propose", RESCUE).spends(wallet().desk) == 0


def test_a_wallet_with_a_daily_limit_names_no_payout_address_of_its_own_accord() -> None:
    """Whoever is named is paid everything from then on."""
    limited, free = wallet(daily_iec=60), wallet()
    for payout, ours in (("bob", False), ("0x" + "9" * 40, False), ("alice", True), (COIN, True)):
        command = parse("set_payout", {"payout": payout})
        assert command.spends(free.desk) == 0
        if ours:
            assert command.spends(limited.desk) == 0
        else:
            with pytest.raises(DailyLimitReached) as refused:
                command.spends(limited.desk)
            assert refused.value.details == {"participant": "alice", "payout": payout}


def test_a_task_stays_posted_where_the_limit_does_not_allow_the_higher_reward(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = wallet(daily_iec=4)
    cancel, post = (SimpleNamespace(name=name) for name in ("cancel_task", "register_task"))
    monkeypatch.setattr(RaiseReward, "calls", lambda *_: [cancel, post])
    with pytest.raises(DailyLimitReached):
        one.execute("raise_reward", {"task_id": 1, "reward_iec": "45"})
    assert one.transactions.orders.sent == []  # type: ignore[attr-defined]
    one.execute("raise_reward", {"task_id": 1, "reward_iec": "44"})
    assert one.transactions.orders.sent == ["cancel_task", "raise_reward"]  # type: ignore[attr-defined]


GWEI = 10**9
PROOF_GAS = 46_400
"""Gas of `submit_proof`, of which the shipped limit of 0.01 ETH pays 172 gwei with the margin."""


def limits(**said: str) -> Limits:
    return Limits(WalletLimits.model_validate(said), IEC)


@pytest.mark.parametrize("gwei", [1, 28, 100, 170])
def test_a_limit_of_a_fee_holds_what_a_transaction_can_cost_and_no_more(gwei: int) -> None:
    market = Market(base_fee=(gwei - 1) * GWEI, priority_fee=GWEI)
    gas, fees = limits(max_fee_eth="0.01").offer(market.fees(), market, PROOF_GAS)
    assert fees.max_fee >= gwei * GWEI and gas >= PROOF_GAS * GAS_MARGIN
    assert gas * fees.max_fee <= ETHER.to_units(Decimal("0.01"))


def test_a_transaction_that_can_cost_more_than_its_limit_is_refused() -> None:
    market = Market(base_fee=172 * GWEI, priority_fee=GWEI)
    with pytest.raises(FeeTooHigh) as refused:
        limits(max_fee_eth="0.01").offer(market.fees(), market, PROOF_GAS)
    assert refused.value.details["gas"] == PROOF_GAS * GAS_MARGIN


def test_without_a_limit_there_is_headroom_and_a_free_chain_costs_nothing() -> None:
    market = Market(base_fee=10 * GWEI, priority_fee=GWEI)
    assert limits().offer(market.fees(), market, PROOF_GAS) == (58_000 + GAS_HEADROOM, market.fees())
    nothing = Market(0, 0)
    gas, fees = limits(max_fee_eth="0.01", daily_fee_eth="0").offer(nothing.fees(), nothing, PROOF_GAS)
    assert (gas, fees.max_fee) == (58_000 + GAS_HEADROOM, 0)


def test_what_is_left_of_the_days_fees_limits_the_next_one() -> None:
    market, day = Market(base_fee=27 * GWEI, priority_fee=GWEI), limits(daily_fee_eth="0.05")
    spent = ETHER.to_units(Decimal("0.048"))
    gas, fees = day.offer(market.fees(), market, PROOF_GAS, spent)
    assert gas * fees.max_fee + spent <= ETHER.to_units(Decimal("0.05")) and gas >= 58_000
    with pytest.raises(DailyLimitReached) as refused:
        day.offer(market.fees(), market, PROOF_GAS, ETHER.to_units(Decimal("0.0484")))
    assert refused.value.details["what"] == "fees"
