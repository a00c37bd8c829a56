"""What an administrator who waits is to do: one run of a command proposes it, and a later one does it when
the delay is over. All that is known of it is on chain: each run goes on, and everybody sees it."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

from eth_account.signers.local import LocalAccount
from eth_utils import to_bytes

from rodeo.chain.client import ChainClient
from rodeo.chain.encoding import Call
from rodeo.chain.governance import WHY, Operation, text_of
from rodeo.durations import span
from rodeo.errors import RodeoError

Say = Callable[[str], object]
Batch = Sequence[Call]
"""Calls that are done together or not at all."""


class DelayRuns(RodeoError):
    """What was proposed cannot be executed yet."""


def waits(client: ChainClient) -> bool:
    """Whether what the administrator does is proposed by a key, and done after a delay."""
    return client.deployment.has_timelock and not client.deployment.decides_by_vote


def proposed(client: ChainClient, why: str) -> dict[bytes, Operation]:
    """What was proposed with this text, and is neither done nor withdrawn, by its id."""
    return {
        key: one
        for key, one in client.pending_operations().items()
        if text_of(one.targets, one.calldatas) == why
    }


def propose(client: ChainClient, key: LocalAccount, wanted: Sequence[Batch], why: str, say: Say) -> None:
    """Propose what is `wanted` and was not, each as an operation of its own: who makes one of them fail holds
    up no other. What was proposed with the same text and is not wanted any more is withdrawn."""
    pending = proposed(client, why)
    missing = [batch for batch in wanted if not any(_is(one, batch) for one in pending.values())]
    for number, one in pending.items():
        if not any(_is(one, batch) for batch in wanted):
            client.send(key, client.governance_calls.cancel(number))
    delay_s = client.decision_delay_s()
    for batch in missing:
        client.send(key, client.governance_calls.schedule(batch, why, os.urandom(32), delay_s))
    if missing:
        say(f"proposed, to be done in {span(delay_s)}: {why}")


def perform(client: ChainClient, key: LocalAccount, wanted: Sequence[Batch], why: str, say: Say) -> None:
    """Do what is `wanted` as far as its delay is over, and propose the rest. Raises DelayRuns while there is
    any."""
    propose(client, key, wanted, why, say)
    ready_s = 0
    for number, one in proposed(client, why).items():
        if client.operation_state(number) == "ready":
            client.send(key, client.governance_calls.perform(one, number))
        else:
            ready_s = max(ready_s, client.operation_ready_s(number))
    if ready_s:
        raise DelayRuns(
            f"what was proposed can be done in {span(ready_s - client.time_s())}: let the site run, and then "
            "run this command again",
            ready_s=ready_s,
            proposed=why,
        )


def withdraw(client: ChainClient, key: LocalAccount, why: Sequence[str]) -> None:
    """Withdraw what was proposed with these texts, and is not done."""
    for one in why:
        for number in proposed(client, one):
            client.send(key, client.governance_calls.cancel(number))


def _is(one: Operation, batch: Batch) -> bool:
    """Whether the operation does what the batch does, whatever its text says."""
    done = [(target, data) for target, data in zip(one.targets, one.calldatas, strict=True) if target != WHY]
    return done == [(call.to, to_bytes(hexstr=call.data)) for call in batch]
