"""Whatever a node answers, only answers to what was asked come in. All else is an error that says why."""

from __future__ import annotations

import json
from collections.abc import Iterator
from email.utils import formatdate
from typing import Any

import pytest

from rodeo.chain.client import connect
from rodeo.chain.node import answers, rpc
from rodeo.chain.node import habits as habits_module
from rodeo.chain.node.answers import Refusal
from rodeo.chain.node.asking import Call, of_blocks
from rodeo.chain.node.errors import ChainUnavailable, ContractReverted, InvalidAnswer, RateLimited
from rodeo.chain.node.habits import Habits
from rodeo.chain.node.rpc import Rpc
from rodeo.chain.node.translation import translated
from rodeo.text import redaction
from tests.support.bad_answers import (
    BAD_BODIES,
    BLOCK,
    FILTER,
    GOOD,
    LOG,
    RECEIPT,
    BadNode,
    Reply,
    bad_results,
    json_reply,
)


@pytest.fixture(scope="module")
def server() -> Iterator[BadNode]:
    with BadNode() as node:
        yield node


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rpc, "BACKOFF_S", 0.0)


@pytest.fixture
def node(server: BadNode) -> BadNode:
    server.answer = None
    server.asked.clear()
    server.headers.clear()
    return server


CHAIN_ID = ("eth_chainId", GOOD["eth_chainId"][0])


def failure(door: Rpc, requests: int) -> InvalidAnswer | RateLimited:
    """Why there is no answer to as many requests: raised, or in its place."""
    try:
        (found,) = door.batch([CHAIN_ID] * requests)
    except (InvalidAnswer, RateLimited) as error:
        return error
    assert isinstance(found, InvalidAnswer | RateLimited)
    return found


def test_good_answers_come_in_as_they_are(node: BadNode) -> None:
    calls = [(method, params) for method, (params, _) in GOOD.items()]
    assert Rpc(node.url).batch(calls) == [good for _, good in GOOD.values()]


@pytest.mark.parametrize("method", GOOD)
def test_a_bad_result_of_any_method_fails_alone(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    door, bad = Rpc("http://127.0.0.1:1"), list(bad_results(method))
    told = iter(bad)

    def post(body: str, _requests: int) -> Any:
        first, second = json.loads(body)
        good = {"id": second["id"], "result": GOOD["eth_chainId"][1]}
        return [good, {"id": first["id"], "result": next(told)}]

    monkeypatch.setattr(door, "_post", post)
    assert len(bad) > 10
    for result in bad:
        spoilt, good = door.batch([(method, GOOD[method][0]), CHAIN_ID])
        assert good == GOOD["eth_chainId"][1]
        assert isinstance(spoilt, InvalidAnswer), result
        assert (spoilt.code, spoilt.details["method"]) == ("chain_unavailable", method)
        assert spoilt.details["problem"] and len(spoilt.details["answer"]) <= 120
        json.dumps(spoilt.to_json(), allow_nan=False).encode()
    assert door.bad == len(bad)


@pytest.mark.parametrize("kind", BAD_BODIES)
@pytest.mark.parametrize("requests", [1, 2])
def test_an_answer_that_is_none_is_an_error_of_its_own(
    kind: str, requests: int, node: BadNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rpc, "habits_of", lambda _url: Habits())
    door = Rpc(node.url)
    node.answer = lambda _payload, good: BAD_BODIES[kind](good)
    error = failure(door, requests)
    assert isinstance(error, RateLimited) == any(word in kind for word in ("429", "503", "string error"))
    json.dumps(error.to_json(), allow_nan=False).encode()
    with pytest.raises(ChainUnavailable), translated():
        # web3.py uses the same door.
        connect(node.url).eth.chain_id  # noqa: B018
    node.answer = None
    assert door.batch([CHAIN_ID] * requests) == ["0x7a69"] * requests


def test_what_a_batch_lacks_and_what_it_has_twice_fails_alone(node: BadNode) -> None:
    node.answer = lambda _payload, good: json_reply([good[2], good[0], good[2], {"id": 99, "result": "0x1"}])
    first, second, third = Rpc(node.url).batch([CHAIN_ID] * 3)
    assert first == "0x7a69"
    assert second.details["problem"] == "it has 0 answers" and third.details["problem"] == "it has 2 answers"


def test_a_refusal_is_no_bad_answer(node: BadNode) -> None:
    node.answer = lambda payload, _good: json_reply(
        {"id": payload["id"], "error": {"code": -32000, "message": "nonce too low"}}
    )
    door = Rpc(node.url)
    assert door.batch([CHAIN_ID]) == [Refusal(-32000, "nonce too low")] and door.bad == 0


@pytest.mark.parametrize("data", ["0xzz", 7, {"data": None}, "0x08c379a0" + "00" * 31 + "20" + "ff" * 40])
def test_revert_data_that_cannot_be_read_is_an_unknown_revert(data: Any, node: BadNode) -> None:
    node.answer = lambda payload, _good: json_reply(
        {"id": payload["id"], "error": {"code": 3, "message": "execution reverted", "data": data}}
    )
    with pytest.raises(ContractReverted, match="UnknownRevert"), translated():
        connect(node.url).eth.call({"to": "0x" + "12" * 20})


@pytest.mark.parametrize("date", [False, True])
def test_a_node_is_left_alone_for_as_long_as_it_asks(
    date: bool, node: BadNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 1_700_000_000.0
    habits = Habits()
    monkeypatch.setattr(rpc, "habits_of", lambda _url: habits)
    monkeypatch.setattr(rpc.time, "monotonic", lambda: now_s)
    monkeypatch.setattr(rpc.time, "time", lambda: now_s)
    after = formatdate(now_s + 7, usegmt=True) if date else "7"
    node.answer = lambda _payload, _good: json_reply({"error": "rate limited"}, 429, retry_after=after)
    with pytest.raises(RateLimited) as limited:
        Rpc(node.url).batch([CHAIN_ID])
    assert limited.value.details["retry_after_s"] == 7.0
    node.answer = None
    now_s += 6.5
    with pytest.raises(RateLimited):
        Rpc(node.url).batch([CHAIN_ID])
    with pytest.raises(RateLimited), translated():
        connect(node.url).eth.chain_id  # noqa: B018
    assert len(node.asked) == 1
    now_s += 0.6
    assert Rpc(node.url).batch([CHAIN_ID]) == ["0x7a69"]


def test_nobody_is_left_alone_for_longer_than_a_minute(
    node: BadNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rpc, "habits_of", lambda _url: Habits())
    for after, pause_s in (("9" * 30, 60.0), ("-5", None), ("soon", None)):
        node.answer = lambda _payload, _good, after=after: json_reply({}, 429, retry_after=after)
        with pytest.raises(RateLimited) as limited:
            Rpc(node.url).batch([CHAIN_ID])
        assert limited.value.details["retry_after_s"] == pause_s


def test_an_error_does_not_quote_the_keys_of_the_url(node: BadNode) -> None:
    url = node.url.replace("//", "//user:hunter22@") + "/v2/0123456789abcdef?key=s3cr%65t-token"
    redaction.learn(url, path_is_secret=True)  # as a site's settings do
    node.answer = lambda _payload, _good: Reply(b"no key 0123456789abcdef s3cret-token hunter22 here", 403)
    with pytest.raises(InvalidAnswer) as bad:
        Rpc(url).batch([CHAIN_ID])
    assert bad.value.details["answer"] == '"no key *** *** *** here"'
    assert node.headers[0]["authorization"].startswith("Basic ")


@pytest.mark.parametrize(
    ("method", "asked"),
    [("eth_chainId", 2), ("eth_sendRawTransaction", 1), ("eth_sendTransaction", 1), ("evm_mine", 1)],
)
def test_where_an_idle_connection_ends_what_only_reads_is_asked_once_more(
    method: str, asked: int, node: BadNode
) -> None:
    ends = [True]
    node.answer = lambda _payload, good: None if ends and ends.pop() else json_reply(good)
    door = Rpc(node.url)
    if asked == 1:
        with pytest.raises(ChainUnavailable, match="does not answer"):
            door.batch([(method, ["0x00"])])
    else:
        door.batch([(method, ["0x00"])])
    assert len(node.asked) == asked
    node.answer = lambda _payload, _good: None
    with pytest.raises(ChainUnavailable, match="does not answer"):
        door.batch([(method, ["0x00"])])
    assert len(node.asked) == 2 * asked


def test_a_body_without_end_is_not_read(node: BadNode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rpc, "MAX_ANSWER_BYTES", 1_000)
    node.answer = lambda _payload, _good: Reply(b" " * 100_000)
    with pytest.raises(InvalidAnswer) as bad:
        Rpc(node.url).batch([CHAIN_ID])
    assert bad.value.details["problem"] == "it is too long"


def test_of_logs_those_count_that_were_asked_for(node: BadNode) -> None:
    anonymous = {**LOG, "topics": []}
    strange = {**LOG, "topics": ["0x" + "ef" * 32]}
    stranger = {**LOG, "address": "0x" + "34" * 20, "blockNumber": None}
    node.answer = lambda payload, _good: json_reply(
        {"id": payload["id"], "result": [anonymous, LOG, strange, stranger]}
    )
    assert Rpc(node.url).batch([("eth_getLogs", [FILTER])]) == [[LOG]]


def test_a_receipt_tells_what_became_of_it_without_a_price_and_with_anonymous_events(node: BadNode) -> None:
    lean = {**RECEIPT, "effectiveGasPrice": None, "logs": [{**LOG, "topics": [], "blockNumber": None}]}
    node.answer = lambda payload, _good: json_reply({"id": payload["id"], "result": lean})
    assert Rpc(node.url).batch([("eth_getTransactionReceipt", [RECEIPT["transactionHash"]])]) == [lean]


def test_a_pending_block_alone_has_no_number_and_no_hash() -> None:
    found = {**BLOCK, "number": None, "hash": None}
    named = ("parentHash", "timestamp", "baseFeePerGas")
    let_in = answers.check("eth_getBlockByNumber", ["pending", False], found)
    assert let_in == {name: BLOCK[name] for name in named}
    with pytest.raises(answers.Malformed):
        answers.check("eth_getBlockByNumber", ["latest", False], found)


def test_one_request_that_a_firewall_answers_in_html_costs_the_others_nothing(node: BadNode) -> None:
    def guarded(payload: Any, good: Any) -> Reply:
        asked = payload if isinstance(payload, list) else [payload]
        html = Reply(b"<html>Forbidden</html>", 403)
        return html if any(one["method"] == "eth_gasPrice" for one in asked) else json_reply(good)

    node.answer = guarded
    found = Rpc(node.url).batch([CHAIN_ID, ("eth_gasPrice", []), CHAIN_ID, CHAIN_ID])
    assert found[0] == found[2] == found[3] == "0x7a69"
    assert isinstance(found[1], InvalidAnswer) and found[1].details["http_status"] == 403


def test_what_a_provider_takes_at_once_is_found_out_once(node: BadNode) -> None:
    def limited(payload: Any, good: Any) -> Reply:
        too_many = isinstance(payload, list) and len(payload) > 10
        return json_reply({"id": None, "error": {"code": -32600, "message": "no"}} if too_many else good)

    node.answer = limited
    door = Rpc(node.url)
    door.habits = Habits()
    assert door.batch([CHAIN_ID] * 40) == ["0x7a69"] * 40
    node.asked.clear()
    assert door.batch([CHAIN_ID] * 40) == ["0x7a69"] * 40
    assert [len(payload) for payload in node.asked] == [10] * 4


def test_an_outage_makes_batches_short_for_a_while_only() -> None:
    habits = Habits()
    habits.note_batch(1, good=False)
    for _ in range(200):
        habits.note_batch(habits.most_calls, good=True)
    assert habits.most_calls == Habits().most_calls


def test_a_range_of_blocks_that_takes_a_node_long_is_shortened_until_it_does_not(
    node: BadNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It answers ten blocks in a second, and stops answering beyond a hundred."""
    now_s = 1000.0
    monkeypatch.setattr(rpc.time, "monotonic", lambda: now_s)

    def slow(payload: Any, _good: Any) -> Reply:
        nonlocal now_s
        asked = payload["params"][0]
        now_s += (int(asked["toBlock"], 16) - int(asked["fromBlock"], 16) + 1) / 10
        return json_reply({"id": payload["id"], "result": []})

    node.answer = slow
    door = Rpc(node.url, timeout_s=10.0)
    door.habits = Habits()
    asked_for = 400
    for _ in range(5):
        try:
            door.batch([of_blocks(LOGS_OF, 1, asked_for)])
        except ChainUnavailable as error:
            assert error.details["reason"] == "no answer in time"
        asked_for = min(asked_for, door.habits.most_blocks)
    assert door.habits.most_blocks == 50
    for _ in range(30):
        door.batch([of_blocks(LOGS_OF, 1, 10)])
    assert door.habits.most_blocks == 50


LOGS_OF: Call = ("eth_getLogs", [{"fromBlock": "0x1", "toBlock": "0x1"}])


def test_the_block_pending_and_a_small_tip_are_tried_again_after_an_hour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = 1000.0
    monkeypatch.setattr(habits_module.time, "monotonic", lambda: now_s)
    habits, call = Habits(), ("eth_getTransactionCount", ["0x" + "12" * 20, "pending"])
    habits.note_tag(call[0], "latest")
    habits.note_tip(25 * 10**9)
    now_s += 3599
    assert habits.adapted(call)[1][-1] == "latest" and habits.least_tip == 25 * 10**9
    now_s += 2
    assert habits.adapted(call) == call and habits.least_tip == 0


@pytest.mark.parametrize(
    "words",
    [
        "block range is too wide",
        "eth_getLogs is limited to a 10,000 range",
        "eth_getLogs is limited to 0 - 10000 blocks range",
        "query returned more than 10000 results. Try with this block range [0x1, 0x2]",
        "Log response size exceeded. You can make eth_getLogs requests with up to a 2K block range",
        "Block range limit exceeded. See more details at the documentation",
        "ranges over 10000 blocks are not supported on freetier",
        "exceed maximum block range: 50000",
        "Too many logs requested. Max logs per response is 20000.",
        "Requested range exceeds maximum range limit",
        "Log query restricted to 5000 block range",
        "invalid block range params",
        "query timeout of 10 seconds exceeded",
        "upstream response too large, please reduce the block range and try again",
        "logs matched by query exceeds limit of 10000",
        "exceeded max limit of blocks, try again with a smaller range",
        "backend response too large",
        "request timed out",
    ],
)
@pytest.mark.parametrize("code", [-32000, -32005, -32602, -32603, -32614, 35])
def test_whatever_words_a_provider_has_for_a_long_range_it_is_asked_for_shorter_ones(
    words: str, code: int, node: BadNode
) -> None:
    def limited(payload: Any, _good: Any) -> Reply:
        asked = payload["params"][0]
        if int(asked["toBlock"], 16) - int(asked["fromBlock"], 16) + 1 > 10:
            return json_reply({"id": payload["id"], "error": {"code": code, "message": words}})
        return json_reply({"id": payload["id"], "result": []})

    node.answer = limited
    door = Rpc(node.url)
    door.habits = Habits()
    assert door.batch([of_blocks(LOGS_OF, 1, 80)]) == [[]]
    assert door.habits.most_blocks <= 10


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        ("transaction underpriced: tip needed 30000000000, tip permitted 1", "cheap"),
        ("max fee per gas less than block base fee: address 0x12, maxFeePerGas: 1, baseFee: 2", "cheap"),
        ("transaction gas price below minimum: gas tip cap 1, minimum needed 25000000000", "cheap"),
        ("gas price too low to be included, minimum 1000000000", "cheap"),
        ("FeeTooLow, EffectivePriorityFeePerGas too low 1 < 2, BaseFee: 3", "cheap"),
        ("effective gas price is lower than the minimum 1000000000", "cheap"),
        ("nonce too low: next nonce 5, tx nonce 4", "past_nonce"),
        ("nonce has already been used", "past_nonce"),
        ("invalid transaction nonce: nonce is too low", "past_nonce"),
        ("OldNonce, Current nonce: 5, nonce of rejected tx: 4", "past_nonce"),
        ("replacement transaction underpriced", "replaces"),
        ("ReplacementNotAllowed", "replaces"),
        ("replacement fee too low", "replaces"),
        ("insufficient funds for gas * price + value: balance 0, tx cost 1", "other"),
    ],
)
def test_refusals_of_transactions_are_told_apart_by_any_nodes_words(words: str, kind: str) -> None:
    error = {"code": -32000, "message": words}
    assert answers.refused(error, ("eth_sendRawTransaction", ["0x02"])).kind == kind


@pytest.mark.parametrize(
    "words",
    [
        "already known",
        "AlreadyKnown",
        "known transaction: 0x12",
        "Known transaction",
        "transaction already imported",
        "tx already exists in the mempool",
        "Transaction with the same hash was already imported.",
        "txn already in pool",
        "transaction already in mempool",
    ],
)
def test_a_transaction_that_is_there_already_was_sent(words: str) -> None:
    error = {"code": -32000, "message": words}
    assert str(answers.refused(error, ("eth_sendRawTransaction", ["0x02"]))).startswith("0x")


@pytest.mark.parametrize(
    "words",
    [
        "Too many requests, please slow down",
        "rate limit exceeded",
        "Your app has exceeded its compute units per second capacity",
        "exceeded the quota usage",
        "call rate limit exhausted, retry in 10s",
        "Request throttled",
        "project ID request rate exceeded",
        "you have exceeded the requests per second limit",
        "too many concurrent requests",
        "Concurrent requests limit exceeded",
    ],
)
@pytest.mark.parametrize("code", [-32000, -32005, -32029, -32097, 429])
def test_a_provider_that_is_asked_too_often_says_so_in_any_words(words: str, code: int) -> None:
    found = answers.refused({"code": code, "message": words}, ("eth_chainId", []))
    assert isinstance(found, RateLimited)
