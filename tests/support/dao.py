"""An organization on a running site, as its participants see it: commands, state, events."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from eth_account.signers.local import LocalAccount
from web3 import Web3

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import DaoEvents
from rodeo.chain.client import ChainClient
from rodeo.chain.deployment import Deployment
from rodeo.judging import votes
from rodeo.site import topics
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.clock import publish_clock
from tests.support.site import RunningSite

PARAMS = {"item_id": "item1", "x_m": 1.0, "y_m": 2.0}
CHARGING = {"robot": "panther1", "dock": "dock1", "soc_from": 0.5, "soc_target": 0.95, "energy_wh": 421.0}


class Dao:
    """Speaks for every participant of `running` and remembers every event."""

    def __init__(self, running: RunningSite) -> None:
        self.running = running
        self.site = running.site
        self.events: list[DaoEvent] = []
        self._changed = threading.Condition()
        self._source: DaoEvents | None = None

    def start(self, before_contracts: Callable[[], object] | None = None) -> None:
        """Router, chain, contracts, bridge. `before_contracts` runs when the chain is there."""
        if before_contracts is None:
            self.running.start_founded("bridge")
        else:
            self.running.start("router", "chain", "bridge", ready=False)
            self.running.wait_ready("chain")
            before_contracts()
            self.running.deploy_contracts()
            self.running.wait_ready("bridge")
        self.listen()

    def listen(self) -> None:
        self._source = DaoEvents(self.running.bus, self.site.org, self._on_event)

    def close(self) -> None:
        if self._source is not None:
            self._source.close()

    def command(self, participant: str, command: str, **fields: Any) -> dict[str, Any]:
        key = topics.COMMAND.name(org=self.site.org, participant=participant, command=command)
        return self.running.bus.query(key, fields, timeout_s=HANG_S)

    def state(self, what: str, **parameters: Any) -> dict[str, Any]:
        return self.running.bus.query(
            topics.STATE.name(org=self.site.org, what=what), parameters=parameters, timeout_s=HANG_S
        )

    def task(self, task_id: int) -> dict[str, Any]:
        return self.state(f"task/{task_id}")

    def balances(self) -> dict[str, float]:
        """Participant -> IEC."""
        return {entry["name"]: float(entry["balance_iec"]) for entry in self.state("wallets")["wallets"]}

    def post(self, reward_iec: str = "100", **fields: Any) -> int:
        """A cleaning task of the organization; its id."""
        request = {"kind": "waste_disposal", "reward_iec": reward_iec, "params": PARAMS, **fields}
        return int(self.command("organization", "register_task", **request)["task_id"])

    def prove(self, task_id: int, participant: str = "panther1", digit: str = "a") -> str:
        """Submit a proof for the running attempt; its hash."""
        sha256 = digit * 64
        self.command(
            participant,
            "submit_proof",
            task_id=task_id,
            attempt=self.task(task_id)["attempt"],
            proof_sha256="0x" + sha256,
            proof_uri=f"{self.site.store_url}/{sha256}.mcap",
        )
        return "0x" + sha256

    def judge(
        self, task_id: int, accepted: bool, reason: str = "as it should be", judge: str = "oracle"
    ) -> None:
        """The oracle's ruling on the submitted proof, at the full price."""
        task = self.task(task_id)
        amount = {"amount_iec": task["price_iec"]} if accepted else {}
        self.verdict(task_id, "accepted" if accepted else "rejected", reason, judge, **amount)

    def verdict(
        self, task_id: int, ruling: str, reason: str = "", judge: str = "oracle", **fields: Any
    ) -> None:
        """A ruling on the submitted proof."""
        task = self.task(task_id)
        nobodys = {"report_sha256": "0x" + "b" * 64, "report_uri": f"{self.site.store_url}/{'b' * 64}.json"}
        self.command(
            judge,
            "rule",
            task_id=task_id,
            attempt=task["attempt"],
            proof_sha256=task["proof_sha256"],
            ruling=ruling,
            reason=reason,
            **{**nobodys, **fields},
        )

    def set_clock(self, time_s: float) -> None:
        """Set the site's clock and return once the chain would stamp its next block with it."""
        chain = Web3(Web3.HTTPProvider(self.site.chain.url))
        publish_clock(self.running.bus, self.site.bus.domain_id, time_s)
        wait_until(
            lambda: chain.eth.get_block("pending")["timestamp"] >= int(time_s),
            lambda: self.running.log("chain"),
        )

    def names_of(self, task_id: int) -> list[str]:
        """Names of the task's events so far, in order."""
        return [event.name for event in self.events if event.task_id == task_id]

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        """Until `condition()` after an event."""
        with self._changed:
            assert self._changed.wait_for(condition, HANG_S), (
                f"{what} did not come\n{self.running.log('bridge')}"
            )

    def catch_up(self) -> None:
        """Until every event that the index has now was heard."""
        last = self.state("chain")["last_seq"]
        self.wait_for(lambda: bool(self.events) and self.events[-1].seq >= last, f"event {last}")

    def client(self) -> ChainClient:
        """The contracts' own answers."""
        return ChainClient(self.site.chain.url, Deployment.load(self.site.data_dir, 31_337))

    def possession(self, key: LocalAccount, owner: str) -> str:
        """By which a new judge's key agrees to sit in the committee of oracles for `owner`, a name."""
        chain = self.client()
        address = next(one["address"] for one in self.state("wallets")["wallets"] if one["name"] == owner)
        committee = chain.deployment.address("OracleCommittee")
        r, vs = votes.possession(key, address, chain.w3.eth.chain_id, committee)
        return "0x" + (r + vs).hex()

    def _on_event(self, event: DaoEvent) -> None:
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()


@contextmanager
def founded(
    path: Path, *processes: str, before_contracts: Callable[[RunningSite], object] | None = None
) -> Iterator[Dao]:
    """An organization on a site of its own, where also these processes run."""
    with RunningSite(path) as running:
        dao = Dao(running)
        try:
            dao.start(before_contracts and (lambda: before_contracts(running)))
            if processes:
                running.start(*processes)
            yield dao
        finally:
            dao.close()
