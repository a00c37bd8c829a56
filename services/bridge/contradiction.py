"""What the index and the contracts disagree about: asked once, when the index was opened or made anew."""

from __future__ import annotations

from eth_utils import function_signature_to_4byte_selector

from rodeo.chain.deployment import Deployment
from rodeo.chain.node.errors import ChainError
from services.bridge.index import Index
from services.bridge.node import Call, Node

_NO_CONTRACT = "0x"
"""What a call returns at a block in which the contract was not there yet."""


def contradiction(index: Index, node: Node, deployment: Deployment) -> str | None:
    """A balance or a count that differs in the contracts at the index's block, or None.

    None, too, where the contracts cannot be asked about that block. Raises ChainUnavailable.
    """
    try:
        said = index.said()
    except (LookupError, TypeError, ValueError) as error:
        return f"the index holds a value that cannot be read: {error}"
    block = said.position.block
    if block < deployment.block:
        return None
    # The index does not know what accounts had of a foreign token before the contracts were there.
    addresses = [] if deployment.is_token_foreign else sorted(said.balances)
    expected: list[tuple[str, int]] = [
        ("the number of tasks", said.tasks),
        ("the number of services", said.services),
        *((f"the balance of {one}", said.balances[one]) for one in addresses),
    ]
    coin = deployment.address("IECoin")
    calls = [
        _view(deployment.address("TaskManager"), "taskCount()", block=block),
        _view(deployment.address("ServiceManager"), "serviceCount()", block=block),
        *(_view(coin, "balanceOf(address)", one, block=block) for one in addresses),
    ]
    answers = node.batch([*calls, ("eth_getBlockByNumber", [hex(block), False])])
    header = answers.pop()
    if not isinstance(header, dict) or header["hash"] != said.position.block_hash:
        return None  # reorganized, which the follower notices
    for (what, value), call, answer in zip(expected, calls, answers, strict=True):
        if isinstance(answer, ChainError) or answer == _NO_CONTRACT or int(answer, 16) == value:
            continue
        # One wrong answer is no reason to read the whole chain again.
        if node.batch([call]) == [answer]:
            return f"{what} is {int(answer, 16)} on chain and {value} in the index, at block {block}"
    return None


def _view(contract: str, signature: str, *addresses: str, block: int) -> Call:
    data = function_signature_to_4byte_selector(signature).hex()
    data += "".join(one.removeprefix("0x").lower().rjust(64, "0") for one in addresses)
    return "eth_call", [{"to": contract, "data": "0x" + data}, hex(block)]
