"""What the follower makes of a node's blocks: at which depth, in what order, with how many questions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from eth_utils import keccak, to_checksum_address

from rodeo.bus.messages import DaoEvent
from rodeo.chain.deployment import Deployment
from rodeo.chain.node.errors import InvalidAnswer
from services.bridge.follower import Follower
from services.bridge.heads import Header
from services.bridge.index import UNDONE, Index, sqlite_url
from services.bridge.node import Call

CONTRACT = to_checksum_address("0x" + "c0" * 20)
OWNER, SPENDER = "0x" + "11" * 20, "0x" + "22" * 20
APPROVAL = "0x" + keccak(text="Approval(address,address,uint256)").hex()


@dataclass
class Chain:
    """A node whose blocks the test makes and takes back, in the place of `Node`."""

    blocks: list[tuple[Header, list[dict[str, Any]]]] = field(default_factory=list)
    asked: list[Sequence[Call]] = field(default_factory=list)
    most_blocks: int = 1 << 20
    _made: int = 0

    def __post_init__(self) -> None:
        self.mine()

    def mine(self, *amounts: int) -> Header:
        """A block with an approval of each amount."""
        self._made += 1
        number = len(self.blocks)
        header = {
            "number": hex(number),
            "hash": "0x" + keccak(self._made.to_bytes(4)).hex(),
            "parentHash": self.blocks[-1][0]["hash"] if self.blocks else "0x" + "00" * 32,
            "timestamp": hex(1_700_000_000 + number),
        }
        logs = [
            {
                "address": CONTRACT,
                "topics": [APPROVAL, "0x" + OWNER[2:].zfill(64), "0x" + SPENDER[2:].zfill(64)],
                "data": "0x" + (amount * 10**18).to_bytes(32).hex(),
                "blockNumber": header["number"],
                "blockHash": header["hash"],
                "logIndex": hex(place),
                "transactionHash": "0x" + keccak(f"{self._made} {place}".encode()).hex(),
            }
            for place, amount in enumerate(amounts)
        ]
        self.blocks.append((header, logs))
        return header

    def take_back(self, count: int) -> None:
        del self.blocks[-count:]

    def batch(self, calls: Sequence[Call]) -> list[Any]:
        self.asked.append(calls)
        return [self._answer(method, params) for method, params in calls]

    def call(self, method: str, *params: Any) -> Any:
        return self.batch([(method, list(params))])[0]

    def _answer(self, method: str, params: list[Any]) -> Any:
        if method == "eth_getBlockByNumber":
            number = len(self.blocks) - 1 if params[0] == "latest" else int(params[0], 16)
            return self.blocks[number][0] if number < len(self.blocks) else None
        assert method == "eth_getLogs"
        wanted = params[0]
        if "blockHash" in wanted:
            return next(logs for header, logs in self.blocks if header["hash"] == wanted["blockHash"])
        first, last = int(wanted["fromBlock"], 16), int(wanted["toBlock"], 16)
        return [one for _, logs in self.blocks[first : last + 1] for one in logs]


@dataclass
class Bus:
    """Where the follower publishes; `router` is whether there is one."""

    router: bool = True
    heard: list[DaoEvent] = field(default_factory=list)

    def publish(self, event: DaoEvent) -> bool:
        if self.router:
            self.heard.append(event)
        return self.router

    def told(self) -> list[str]:
        """Amounts approved, and -amounts of what was undone; the sequence has no gap and no double."""
        assert [event.seq for event in self.heard] == list(range(1, len(self.heard) + 1))
        return [("-" if event.name == UNDONE else "") + event.args["value_iec"] for event in self.heard]


@pytest.fixture
def chain() -> Chain:
    return Chain()


@pytest.fixture
def bus() -> Bus:
    return Bus()


def follow(chain: Chain, bus: Bus, folder: Path, confirmations: int = 0, foreign: bool = False) -> Follower:
    """A bridge that starts, with what the one before it left in `folder`."""
    genesis = chain.blocks[0][0]["hash"]
    contracts = {"IECoin": CONTRACT}
    deployment = Deployment(
        chain_id=1, genesis_hash=genesis, block=0, contracts=contracts, is_token_foreign=foreign
    )
    index = Index(sqlite_url(folder / "index.sqlite"), 1, genesis, contracts)
    return Follower(chain, deployment, index, confirmations, bus.publish)  # type: ignore[arg-type]


def settle(follower: Follower) -> None:
    while follower.step([]):
        pass


def test_events_come_when_enough_blocks_are_on_top(chain: Chain, bus: Bus, tmp_path: Path) -> None:
    follower = follow(chain, bus, tmp_path, confirmations=2)
    chain.mine(1)
    chain.mine(2)
    settle(follower)
    assert bus.told() == []
    chain.mine()
    settle(follower)
    assert bus.told() == ["1"]
    chain.mine()
    settle(follower)
    assert (bus.told(), follower.behind) == (["1", "2"], 0)


def test_headers_that_the_node_tells_of_do_not_make_events_come_earlier(
    chain: Chain, bus: Bus, tmp_path: Path
) -> None:
    follower = follow(chain, bus, tmp_path, confirmations=1)
    settle(follower)
    follower.step([chain.mine(1)])
    settle(follower)
    assert bus.told() == []


def test_a_reorganization_above_the_depth_is_never_seen(chain: Chain, bus: Bus, tmp_path: Path) -> None:
    follower = follow(chain, bus, tmp_path, confirmations=2)
    chain.mine(1)
    chain.mine(2)
    chain.mine(3)
    settle(follower)
    chain.take_back(2)
    settle(follower)
    for amount in (4, 5, 6, 7):
        chain.mine(amount)
    settle(follower)
    assert bus.told() == ["1", "4", "5"]


def test_a_deeper_one_is_told_newest_first(chain: Chain, bus: Bus, tmp_path: Path) -> None:
    follower = follow(chain, bus, tmp_path, confirmations=1)
    chain.mine(1)
    chain.mine(2)
    chain.mine(3)
    chain.mine()
    settle(follower)
    chain.take_back(3)
    for amount in (4, 5, 6):
        chain.mine(amount)
    settle(follower)
    assert bus.told() == ["1", "2", "3", "-3", "-2", "4", "5"]


def test_blocks_that_the_node_tells_of_cost_one_question(chain: Chain, bus: Bus, tmp_path: Path) -> None:
    follower = follow(chain, bus, tmp_path)
    settle(follower)
    chain.asked.clear()
    assert not follower.step([chain.mine(1), chain.mine(), chain.mine(2, 3)])
    assert (bus.told(), len(chain.asked)) == (["1", "2", "3"], 1)


def test_what_the_node_did_not_tell_of_is_read_as_well(chain: Chain, bus: Bus, tmp_path: Path) -> None:
    follower = follow(chain, bus, tmp_path)
    settle(follower)
    chain.mine(1)
    told = chain.mine(2)
    assert follower.step([told])
    settle(follower)
    assert bus.told() == ["1", "2"]


def test_a_header_of_another_branch_undoes_what_it_replaces(chain: Chain, bus: Bus, tmp_path: Path) -> None:
    follower = follow(chain, bus, tmp_path)
    chain.mine(1)
    chain.mine(2)
    settle(follower)
    chain.take_back(1)
    headers = [chain.mine(3), chain.mine(4)]
    while follower.step(headers):
        headers = []
    assert bus.told() == ["1", "2", "-2", "3", "4"]


def test_what_happened_without_a_router_is_published_afterwards(
    chain: Chain, bus: Bus, tmp_path: Path
) -> None:
    follower = follow(chain, bus, tmp_path)
    settle(follower)
    bus.router = False
    chain.mine(1)
    chain.mine(2, 3)
    settle(follower)
    assert bus.told() == []
    chain.mine(4)
    bus.router = True
    settle(follower)
    assert bus.told() == ["1", "2", "3", "4"]


def test_a_new_bridge_publishes_what_the_one_before_it_did_not(
    chain: Chain, bus: Bus, tmp_path: Path
) -> None:
    bus.router = False
    chain.mine(1)
    settle(follow(chain, bus, tmp_path))
    bus.router = True
    chain.mine(2)
    settle(follow(chain, bus, tmp_path))
    assert bus.told() == ["1", "2"]
    settle(follow(chain, bus, tmp_path))
    assert bus.told() == ["1", "2"]


@pytest.mark.parametrize("spoilt", [{"topics": [APPROVAL]}, {"data": "0x"}, {"data": "0x" + "00" * 31}])
@pytest.mark.parametrize("foreign", [True, False])
def test_an_event_that_cannot_be_read_is_left_out_only_of_a_token_that_was_there_before(
    spoilt: dict[str, Any], foreign: bool, chain: Chain, bus: Bus, tmp_path: Path
) -> None:
    follower = follow(chain, bus, tmp_path, foreign=foreign)
    chain.mine(1, 2, 3)
    whole = dict(chain.blocks[-1][1][1])
    chain.blocks[-1][1][1].update(spoilt)
    if foreign:
        settle(follower)
        assert bus.told() == ["1", "3"]
        return
    for _ in range(5):
        with pytest.raises(InvalidAnswer):
            settle(follower)
    assert bus.told() == []
    chain.blocks[-1][1][1].update(whole)
    settle(follower)
    assert bus.told() == ["1", "2", "3"]


def test_a_block_without_the_time_of_its_logs_is_asked_for_it(chain: Chain, bus: Bus, tmp_path: Path) -> None:
    for number in range(3):
        chain.mine(number)
        chain.blocks[-1][1][0]["blockTimestamp"] = [None, "0x6553f102", None][number]
    settle(follow(chain, bus, tmp_path))
    assert [event.time_s for event in bus.heard] == [1_700_000_001, 1_700_000_002, 1_700_000_003]
