"""Whether the index says what was written to it, and what the contracts say: at its start and now and then.

A value that was changed in its file, by hand or by the disk, must not be told for truth: the index is made
anew from the chain then.
"""

from __future__ import annotations

import logging
import threading
import time

from eth_utils import function_signature_to_4byte_selector
from sqlalchemy.exc import DBAPIError

from rodeo.chain.deployment import Deployment
from rodeo.chain.errors import ChainError, ChainUnavailable
from services.bridge.index import Index
from services.bridge.node import Call, Node

log = logging.getLogger(__name__)

PERIOD_S = 20.0
"""Wall time between two looks."""

_SHARE = 0.01
"""Of a core that goes into looking, where there is much to look at."""

_MOST_BALANCES = 200
"""Asked of the chain at one look that is not the first; the others have their turn at the next ones."""

_NO_CONTRACT = "0x"
"""What a call returns at a block in which the contract was not there yet."""


class Inspector:
    """Looks at `index` in a thread of its own; `found` is what was wrong with it, until `reset`."""

    def __init__(self, index: Index, node: Node, deployment: Deployment) -> None:
        self._index = index
        self._node = node
        self._coin = deployment.address("IECoin")
        # What accounts had of another token before the contracts were there, the index does not know.
        self._knows_balances = not deployment.is_token_foreign
        self._counts = {
            deployment.address("TaskManager"): "taskCount()",
            deployment.address("ServiceManager"): "serviceCount()",
        }
        self._founded_in = deployment.block
        self._asked = 0
        self._generation = 0
        self._closed = threading.Event()
        self.found: str | None = None
        self._thread = threading.Thread(target=self._run, name="inspector", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()

    def reset(self) -> None:
        """The index was made anew: what was found before counts no more."""
        self._generation += 1
        self.found = None

    def compare(self, most: int | None = None) -> str | None:
        """What the index says and the contracts do not say at the same block; None where they cannot be asked
        about it. Of the balances at most `most`, all by default. Raises ChainUnavailable."""
        said = self._index.said()
        block = said.position.block
        if block < self._founded_in:
            return None
        addresses = sorted(said.balances) if self._knows_balances else []
        first = self._asked % max(1, len(addresses))
        addresses = (addresses[first:] + addresses[:first])[:most]
        self._asked = first + len(addresses)
        expected: list[tuple[str, int]] = [
            ("the number of tasks", said.tasks),
            ("the number of services", said.services),
            *((f"the balance of {one}", said.balances[one]) for one in addresses),
        ]
        calls = [_view(contract, name, block=block) for contract, name in self._counts.items()]
        calls += [_view(self._coin, "balanceOf(address)", one, block=block) for one in addresses]
        answers = self._node.batch([*calls, ("eth_getBlockByNumber", [hex(block), False])])
        header = answers.pop()
        if not isinstance(header, dict) or header["hash"] != said.position.block_hash:
            return None  # reorganized, which the follower notices
        for (what, value), call, answer in zip(expected, calls, answers, strict=True):
            if isinstance(answer, ChainError) or answer == _NO_CONTRACT or int(answer, 16) == value:
                continue
            # One wrong answer is not worth reading the whole chain again.
            if self._node.batch([call]) == [answer]:
                return f"{what} is {int(answer, 16)} on chain and {value} in the index, at block {block}"
        return None

    def _run(self) -> None:
        pause_s = PERIOD_S
        while not self._closed.wait(pause_s):
            started_s, generation = time.thread_time(), self._generation
            try:
                problem = self._index.problem() or self.compare(_MOST_BALANCES)
            except (ChainUnavailable, DBAPIError) as error:
                log.debug("will inspect the index later: %s", error)
                continue
            except (LookupError, TypeError, ValueError) as error:
                problem = f"it holds a value that cannot be read: {error}"
            if problem is not None and generation == self._generation:
                self.found = problem
            pause_s = max(PERIOD_S, (time.thread_time() - started_s) / _SHARE)


def _view(contract: str, signature: str, *addresses: str, block: int) -> Call:
    data = function_signature_to_4byte_selector(signature).hex()
    data += "".join(one.removeprefix("0x").lower().rjust(64, "0") for one in addresses)
    return "eth_call", [{"to": contract, "data": "0x" + data}, hex(block)]
