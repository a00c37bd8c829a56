"""Proposals of anybody: any bytes as text, any call."""

from __future__ import annotations

import pytest
from eth_abi import encode
from eth_utils import keccak

from rodeo.chain import artifacts
from rodeo.chain.calls import OrganizationCalls
from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import Terms
from rodeo.chain.contracts.logs import decode_json_log, event_topics
from rodeo.chain.contracts.types import ZERO_ADDRESS
from rodeo.chain.deployment import Deployment
from rodeo.chain.governance import described
from rodeo.chain.proposals import protected_text, shown_text

MEMBER = "0x" + "0a" * 20
DEPLOYMENT = Deployment(
    chain_id=1,
    genesis_hash="0x00",
    block=0,
    contracts={
        name: f"0x{number:040}"
        for number, name in enumerate((*artifacts.CONTRACTS, *artifacts.GOVERNANCE), start=1)
    },
)


def test_the_text_of_a_proposal_may_be_any_bytes() -> None:
    types = "(uint256,address,address[],uint256[],string[],bytes[],uint256,uint256,string)"
    topic = "0x" + keccak(text="ProposalCreated" + types).hex()
    assert topic in event_topics()
    # As bytes, which are encoded as a string is, because eth-abi writes no such string.
    values = [2**255, MEMBER, [MEMBER], [0], [""], [b"\xff"], 5, 9, b"a\xff\0b"]
    data = encode([*types.strip("()").split(",")[:-1], "bytes"], values)
    log = decode_json_log(
        {
            "topics": [topic],
            "data": "0x" + data.hex(),
            "address": DEPLOYMENT.address("OrganizationGovernor"),
            "blockNumber": "0x1",
            "blockHash": "0x00",
            "logIndex": "0x0",
            "transactionHash": "0x00",
        }
    )
    assert isinstance(log.event, events.ProposalCreated)
    assert (log.event.proposal_id, log.event.description) == (2**255, "a�\0b")
    assert log.event.calldatas == [b"\xff"]


def test_calls_are_shown_by_name_and_what_is_no_call_as_it_is() -> None:
    call = OrganizationCalls(DEPLOYMENT).set_terms(Terms(50, 20, 2))
    shown = described(DEPLOYMENT, call.to, bytes.fromhex(call.data[2:]))
    assert (shown.contract, shown.function) == ("Organization", "setTerms")
    assert shown.args == {"terms": {"bond": 50, "penalty": 20, "max_failures": 2}}
    stranger = described(DEPLOYMENT, MEMBER, b"\x01\x02")
    assert (stranger.contract, stranger.function, stranger.args) == (MEMBER, "", {"data": "0x0102"})


def test_calls_within_a_call_are_shown_too() -> None:
    """A proposal that sets terms in a multicall would else be a heap of bytes for those who vote."""
    calls = OrganizationCalls(DEPLOYMENT)
    terms, hidden = calls.set_terms(Terms(50, 20, 2)), calls.set_members_only(True)
    inner = calls.multicall([bytes.fromhex(hidden.data[2:]), b"\x01"])
    outer = calls.multicall([bytes.fromhex(one.data[2:]) for one in (terms, inner)])
    shown = described(DEPLOYMENT, outer.to, bytes.fromhex(outer.data[2:]))
    first, second = shown.args["calls"]
    assert (shown.function, first["function"]) == ("multicall", "setTerms")
    assert first["args"]["terms"]["bond"] == 50
    assert second["args"]["calls"] == [
        {"function": "setMembersOnly", "args": {"members_only": True}},
        {"function": "", "args": {"data": "0x01"}},
    ]


def test_calls_that_are_nested_without_end_are_shown_as_bytes() -> None:
    calls = OrganizationCalls(DEPLOYMENT)
    call = calls.set_members_only(True)
    for _ in range(600):
        call = calls.multicall([bytes.fromhex(call.data[2:])])
    args = described(DEPLOYMENT, call.to, bytes.fromhex(call.data[2:])).args
    for _ in range(4):
        ((nested),) = args["calls"]
        args = nested["args"]
    assert nested["function"] == "multicall" and args["data"][0].startswith("0x")


@pytest.mark.parametrize("arguments", [b"", b"\xff" * 32, b"\0" * 31 + b"\x07" + b"\xff" * 300])
@pytest.mark.parametrize(
    "function", ["setBudget(bytes32,uint96,uint8)", "registerService(bytes32,uint96,uint96,string)"]
)
def test_arguments_that_do_not_fit_are_shown_as_bytes(function: str, arguments: bytes) -> None:
    data = keccak(text=function)[:4] + arguments
    shown = described(DEPLOYMENT, DEPLOYMENT.address("Organization"), data)
    assert (shown.contract, shown.function) == ("Organization", "")
    assert shown.args == {"data": "0x" + data.hex()}


def test_only_the_proposers_own_address_is_left_out_of_the_text_that_people_read() -> None:
    text = protected_text("a bond", MEMBER)
    assert shown_text(text, MEMBER) == "a bond" and shown_text(text.lower(), MEMBER.upper()) == "a bond"
    assert shown_text(text, ZERO_ADDRESS) == text
    assert shown_text("a bond", MEMBER) == "a bond" and shown_text(MEMBER, MEMBER) == MEMBER
