"""A bad answer of the node holds up what it is about and nothing else. The bridge is not ready meanwhile."""

from __future__ import annotations

import json
import threading
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from eth_account import Account

from deploy.chain.errors import RpcError
from rodeo.chain.node.errors import (
    ChainError,
    ChainUnavailable,
    ContractReverted,
    TransactionFailed,
    TransactionTimeout,
)
from rodeo.runtime.state import Notices
from rodeo.signing import wallets
from rodeo_testing.waiting import wait_until
from services.bridge import orders, process, readiness
from services.bridge.chain import Chain
from services.bridge.orders import Order
from services.bridge.process import Bridge
from services.bridge.queries import Queries
from services.bridge.readiness import Probe
from tests.support.bad_answers import BAD_BODIES, BadNode, json_reply
from tests.support.bridge_wallet import Robot
from tests.support.chain import Answer
from tests.support.deployed import DeployedChain

pytestmark = pytest.mark.long

SEND, RECEIPT, COUNT = "eth_sendRawTransaction", "eth_getTransactionReceipt", "eth_getTransactionCount"
METHODS = [
    "eth_chainId",
    "eth_call",
    "eth_estimateGas",
    "eth_getBlockByNumber",
    "eth_getLogs",
    "eth_maxPriorityFeePerGas",
    COUNT,
    RECEIPT,
    SEND,
]
KINDS = ["a string error", "a JSON string", "null", "a list of null", "HTML", "an empty body", "other ids"]
BAD: list[Any] = [5, "zz", {}, [None]]


@pytest.fixture
def probe(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> Probe:
    monkeypatch.setattr(readiness, "time", SimpleNamespace(monotonic=lambda: robot.wall_s))
    monkeypatch.setattr(readiness, "PERIOD_S", 1.0)
    chain = Chain(robot.chain.deployment, robot.node, robot.index, robot.journal)
    return Probe(chain, {"panther1": robot.account.address}, robot.transactions.outcomes)


@pytest.fixture
def other(robot: Robot) -> Callable[[], Any]:
    """Orders something of another wallet."""
    account = wallets.load(robot.chain.site, "oracle")
    robot.transactions.orders.add("oracle", account.address, account, robot.limits)
    calls, numbers = robot.client.calls, iter(range(1, 1000))
    return lambda: robot.transactions.orders.submit(
        Order("oracle", "approve", calls.approve(robot.client.task_manager, next(numbers)))
    )


def go_on(robot: Robot, steps: int, step_s: float = 0.6) -> None:
    """What the bridge's threads do, which go on after each error."""
    for _ in range(steps):
        for part in (robot.transactions.step, lambda: robot.follower.step([]), robot.transactions.step):
            with suppress(ChainError):
                part()
        robot.wall_s += step_s


def found(probe: Probe) -> str | None:
    """What it finds at its next look."""
    probe.watch()
    return probe.problem()


@pytest.mark.parametrize("method", METHODS)
def test_while_a_method_is_answered_badly_the_bridge_is_not_ready_and_each_outcome_comes_afterwards(
    method: str, robot: Robot, probe: Probe
) -> None:
    robot.pay()
    assert found(probe) is None
    before = robot.paid()
    for number, bad in enumerate([*BAD, *([] if method == RECEIPT else [None])], start=1):
        future = robot.transactions.orders.submit(robot.order(request_id=f"{number}"))
        robot.chain.node.fault = lambda asked, params, answer, bad=bad: (
            bad if asked == method else answer(asked, params)
        )
        go_on(robot, steps=6)
        problem = found(probe)
        assert problem is not None and ("answer" in problem or "newest block" in problem), bad
        robot.chain.node.fault = None
        robot.wall_s += 1.0
        robot.outcome(future)
        robot.wall_s += 1.0
        assert found(probe) is None
        assert robot.paid() == before + 5 * number and robot.waiting() == 0


def about(robot: Robot, method: str, params: Sequence[Any]) -> bool:
    """Whether the robot's own transactions or nonces are asked about."""
    address = robot.account.address
    if method == SEND:
        return bool(Account.recover_transaction(params[0]) == address)
    if method == RECEIPT:
        return any(params[0] in one.hashes for one in robot.journal.unfinished() if one.wallet == "panther1")
    if method == "eth_estimateGas":
        return bool(params[0]["from"] == address and params[0]["to"] != address)
    return method == COUNT and params[0] == address


@pytest.mark.parametrize("method", ["eth_estimateGas", COUNT, SEND, RECEIPT])
def test_what_is_answered_badly_about_one_wallet_holds_up_no_other(
    method: str, robot: Robot, other: Callable[[], Any], probe: Probe
) -> None:
    robot.outcome(other())
    for bad in BAD:
        before = robot.paid()
        robot.chain.node.fault = lambda asked, params, answer, bad=bad: (
            bad if asked == method and about(robot, asked, params) else answer(asked, params)
        )
        ours, theirs = robot.transactions.orders.submit(robot.order()), other()
        go_on(robot, steps=6)
        assert theirs.result(timeout=0)["tx_hash"] and not ours.done()
        if method != COUNT:
            assert found(probe) is None  # others can send
        robot.chain.node.fault = None
        robot.wall_s += 1.0
        robot.outcome(ours)
        assert robot.paid() == before + 5


def without(name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda receipt: {key: value for key, value in receipt.items() if key != name}


def with_null(name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda receipt: {**receipt, name: None}


@pytest.mark.parametrize("name", ["blockNumber", "blockHash", "status", "gasUsed", "logs", "transactionHash"])
def test_a_receipt_that_is_incomplete_is_asked_for_again(
    name: str, robot: Robot, other: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(orders, "OUTCOME_S", 3.0)
    for spoil in (without(name), with_null(name)):
        before = robot.paid()

        def spoilt(method: str, params: Sequence[Any], answer: Answer, spoil: Any = spoil) -> Any:
            found = answer(method, params)
            return spoil(found) if method == RECEIPT and found and about(robot, method, params) else found

        robot.chain.node.fault = spoilt
        ours = robot.transactions.orders.submit(robot.order(request_id=f"{before}"))
        theirs = other()
        go_on(robot, steps=8)
        assert theirs.result(timeout=0)["tx_hash"]
        with pytest.raises(TransactionTimeout, match="do not tell whether it is mined") as late:
            ours.result(timeout=0)
        assert name in late.value.details["reason"]
        robot.chain.node.fault = None
        assert robot.pay(request_id=f"{before}")["block"] and robot.paid() == before + 5


@pytest.mark.parametrize("spoil", [without("effectiveGasPrice"), with_null("effectiveGasPrice")])
def test_a_receipt_without_a_price_is_counted_at_the_most_that_it_can_have_cost(
    spoil: Callable[[dict[str, Any]], dict[str, Any]], robot: Robot
) -> None:
    receipts: list[dict[str, Any]] = []

    def spoilt(method: str, params: Sequence[Any], answer: Answer) -> Any:
        found = answer(method, params)
        if method != RECEIPT or not found:
            return found
        receipts.append(found)
        return spoil(found)

    robot.chain.node.fault = spoilt
    robot.pay(request_id="r")
    entry = robot.journal.find("panther1", "r")
    assert entry is not None and entry.max_fee is not None
    assert robot.journal.spent("panther1", -1.0)[1] == int(receipts[-1]["gasUsed"], 16) * entry.max_fee


def test_anonymous_and_strange_events_in_receipts_hold_up_nobody(
    robot: Robot, other: Callable[[], Any]
) -> None:
    coin = robot.chain.deployment.address("IECoin").lower()

    def with_more(method: str, params: Sequence[Any], answer: Answer) -> Any:
        found = answer(method, params)
        if method != RECEIPT or not found:
            return found
        (log,) = found["logs"]
        anonymous = [{**log, "topics": [], "address": one} for one in (coin, "0x" + "12" * 20)]
        other_layout = {**log, "topics": log["topics"][:1]}
        return {**found, "logs": [*anonymous, other_layout, {**log, "topics": ["0x" + "34" * 32]}, log]}

    robot.chain.node.fault = with_more
    ours, theirs = robot.transactions.orders.submit(robot.order()), other()
    go_on(robot, steps=3)
    assert ours.result(timeout=0)["block"] and theirs.result(timeout=0)["block"]


def test_what_is_mined_is_not_told_to_be_not_mined_while_the_index_cannot_follow(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(orders, "OUTCOME_S", 3.0)
    robot.chain.node.fault = lambda method, params, answer: (
        [None] if method == "eth_getLogs" else answer(method, params)
    )
    future = robot.transactions.orders.submit(robot.order(request_id="r"))
    go_on(robot, steps=8)
    block = robot.client.w3.eth.block_number
    with pytest.raises(TransactionTimeout, match=f"mined in block {block}, but"):
        future.result(timeout=0)
    robot.chain.node.fault = None
    assert robot.pay(request_id="r")["block"] == block


@pytest.mark.parametrize("error", [ChainUnavailable("gone"), KeyError("not foreseen")])
@pytest.mark.parametrize("duty", ["reopen_undone", "look_at_held"])
def test_a_duty_that_fails_keeps_nobody_from_the_others(
    duty: str, error: Exception, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise error

    monkeypatch.setattr(robot.transactions.outcomes, duty, fail)
    future = robot.transactions.orders.submit(robot.order())
    for _ in range(3):
        with pytest.raises(type(error)):
            robot.transactions.step()
        while robot.follower.step([]):
            pass
        robot.wall_s += 0.6
    assert future.result(timeout=0)["block"]


@pytest.mark.parametrize("cured", [True, False])
def test_why_a_transaction_failed_is_asked_again_for_a_while(
    cured: bool, robot: Robot, other: Callable[[], Any]
) -> None:
    most = robot.client.token.balance(robot.account.address) * 2 // 3
    submit = robot.transactions.orders.submit
    first, second = (submit(robot.order(most, request)) for request in ("first", "second"))
    robot.chain.node.fault = lambda method, params, answer: (
        "zz" if method == "eth_call" else answer(method, params)
    )
    go_on(robot, steps=1)
    theirs = other()
    go_on(robot, steps=3)
    assert first.done() and theirs.done() and not second.done()
    if cured:
        robot.chain.node.fault = None
    go_on(robot, steps=10)
    assert isinstance(second.exception(timeout=0), ContractReverted if cured else TransactionFailed)


def failing(rpc_code: int, message: str) -> RpcError:
    error = RpcError(message)
    error.rpc_code = rpc_code
    return error


@pytest.mark.parametrize(
    ("method", "error"),
    [
        (SEND, failing(-32005, "limit exceeded")),
        (SEND, failing(429, "slow down")),
        (SEND, failing(-32603, "oops")),
        ("eth_estimateGas", failing(-32000, "Rate limit reached")),
    ],
)
def test_what_a_provider_refuses_because_of_itself_is_sent_again(
    method: str, error: RpcError, robot: Robot
) -> None:
    before, refused = robot.paid(), 0

    def refuse(asked: str, params: Sequence[Any], answer: Answer) -> Any:
        nonlocal refused
        if asked == method and refused < 3:
            refused += 1
            raise error
        return answer(asked, params)

    robot.chain.node.fault = refuse
    robot.pay(request_id="mine")
    assert refused == 3 and robot.paid() == before + 5 and robot.journal.count("dropped") == 0


def forward(url: str) -> Callable[[Any], Any]:
    def ask(payload: Any) -> Any:
        request = urllib.request.Request(
            url, json.dumps(payload).encode(), {"content-type": "application/json"}
        )
        with urllib.request.urlopen(request) as answer:
            return json.load(answer)

    return ask


class Told:
    """A process's readiness, as it was told last."""

    def __init__(self, chain: DeployedChain, url: str, folder: Path) -> None:
        self.site = chain.site.model_copy(
            update={"chain": chain.site.chain.model_copy(update={"url": url, "websocket_url": ""})}
        )
        self.name, self.data_dir, self.stop = "bridge", folder, threading.Event()
        self.bus = SimpleNamespace(connected=False, serve=lambda *_args, **_options: None)
        clock = SimpleNamespace(notify=lambda: None, now_s=lambda: 0.0, wait_for=self._wait)
        clock.acting = clock.hold = self._nothing
        self.clock = clock
        self.reason: str | None = "starting"
        self.reasons: list[str] = []
        self.notices = Notices()

    @contextmanager
    def _nothing(self) -> Iterator[None]:
        yield

    def _wait(self, _condition: Any, stop: threading.Event, **_options: Any) -> None:
        stop.wait(0.05)

    def ready(self, _lapses_s: float) -> None:
        self.reason = None

    def not_ready(self, reason: str) -> None:
        self.reason = reason
        self.reasons.append(reason)

    def activity(self, *_args: Any, **_details: Any) -> None:
        """Nobody looks."""


def spoilt(payload: Any, good: Any, method: str) -> Any:
    """`good` with another result of this method."""
    if isinstance(payload, list):
        return [spoilt(one, answer, method) for one, answer in zip(payload, good, strict=True)]
    return {**good, "result": 5} if payload["method"] == method else good


def unforeseen(step: Callable[..., bool]) -> Callable[..., bool]:
    """Fails three times in a way that nobody thought of."""
    failures = iter([KeyError("oops")] * 3)

    def fail_first(*args: Any) -> bool:
        for error in failures:
            raise error
        return step(*args)

    return fail_first


def test_a_price_that_the_node_does_not_tell_is_left_out_of_what_is_shown(robot: Robot) -> None:
    hashes = [robot.pay()["tx_hash"] for _ in range(3)]

    def without_price(method: str, params: Sequence[Any], answer: Answer) -> Any:
        found = answer(method, params)
        if method == RECEIPT and params[0] in hashes[:2]:
            return {**found, ("effectiveGasPrice", "from")[hashes.index(params[0])]: None}
        return found

    robot.chain.node.fault = without_price
    queries = SimpleNamespace(_node=robot.node, _names=SimpleNamespace(address=str))
    shown = Queries._receipts(queries, hashes)  # type: ignore[arg-type]
    assert [one["tx_hash"] for one in shown] == hashes[2:]


def test_the_bridge_outlives_every_kind_of_answer_and_is_ready_only_before_and_after(
    chain: DeployedChain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "_RETRY_S", 0.01)
    monkeypatch.setattr(readiness, "RETRY_S", 0.05)
    monkeypatch.setattr(readiness, "PERIOD_S", 0.1)
    with BadNode(forward(chain.site.chain.url)) as node:
        told = Told(chain, node.url, tmp_path)
        (tmp_path / "new-journal").touch()  # the wallets have sent in other tests
        bridge = threading.Thread(target=Bridge(told).run, daemon=True)  # type: ignore[arg-type]
        node.answer = lambda _payload, _good: json_reply({"error": "rate limited"}, 429)
        bridge.start()
        try:
            wait_until(lambda: "rate limited" in (told.reason or ""), "it does not say why it cannot start")
            for kind in KINDS:
                node.answer = None
                wait_until(lambda: told.reason is None, lambda: f"not ready: {told.reason}")
                node.answer = lambda _payload, good, spoil=BAD_BODIES[kind]: spoil(good)
                wait_until(lambda: told.reason is not None, f"ready while the node gives {kind}")
                assert bridge.is_alive() and "node" in (told.reason or "node")
            for method in ("eth_maxPriorityFeePerGas", RECEIPT, "eth_call"):
                node.answer = None
                wait_until(lambda: told.reason is None, lambda: f"not ready: {told.reason}")
                node.answer = lambda payload, good, bad=method: json_reply(spoilt(payload, good, bad))
                wait_until(lambda: told.reason is not None, f"ready while {method} is answered badly")
            node.answer = None
            wait_until(lambda: told.reason is None, lambda: f"not ready: {told.reason}")
            monkeypatch.setattr(Bridge, "_step", unforeseen(Bridge._step))
            wait_until(
                lambda: any("KeyError" in one for one in told.reasons),
                "it does not say what it did not foresee",
            )
            wait_until(lambda: told.reason is None, lambda: f"not ready: {told.reason}")
        finally:
            told.stop.set()
            bridge.join()
