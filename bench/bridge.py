"""The bridge on anvil (subscribed over a WebSocket) and on the embedded chain (asked).

`event_latency_ms_*`: from the node having the block (its answer to eth_sendRawTransaction) to the message at
a subscriber of the bus, for transactions that the bridge knows nothing of.
`tx_throughput_*`: commands answered per second of one wallet that many callers use at once, over what web3.py
reaches on the same node in the same run: signed one after the other, all sent, then all receipts waited for.
`quorum_verdict_ms`: from the third of five oracles' votes on the bus to the payment, the median of VERDICTS.
`index_10000_s`: from an empty database to 10,000 tasks that ended, without the node.
"""

from __future__ import annotations

import json
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from pathlib import Path

from eth_account import Account

from bench import past
from deploy import contracts
from deploy.launcher import Launcher
from rodeo.bus.messages import Vote
from rodeo.bus.session import Bus
from rodeo.chain.client import ChainClient
from rodeo.chain.contracts import events
from rodeo.chain.contracts.logs import Log
from rodeo.chain.contracts.types import ZERO_ADDRESS
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call
from rodeo.commands.services import RegisterService
from rodeo.commands.tasks import RegisterTask
from rodeo.commands.treasury import Transfer
from rodeo.dao import Participant
from rodeo.host.clock import WallClock
from rodeo.signing import wallets
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.endpoint import free_port
from services.bridge.follower import MAX_BLOCKS
from services.bridge.index import Index, Position, TimedLog, sqlite_url
from services.oracle.voters import Voters
from services.oracle.votes import Votes

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
CHAIN_ID = 31_337
DEV_KEY = "0xac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80"
"""First account of the public test mnemonic, which every local chain funds."""

EVENTS = 300
TRANSACTIONS = 300
VERDICTS = 20
KIND = "waste_disposal"
CALLERS = 32
_PACE_S = 0.013
"""Between two events: coprime with the bridge's polling period, so that all its phases are hit."""


def run() -> dict[str, float]:
    """Measure on sites of its own, on free ports, in folders that are removed."""
    return {
        **{f"{name}_anvil": value for name, value in _measure("anvil").items()},
        **{f"{name}_eth_tester": value for name, value in _measure("eth-tester").items()},
        "index_10000_s": _index_from_nothing(10_000),
        "quorum_verdict_ms": _quorum_verdict_ms(),
    }


def _measure(backend: str) -> dict[str, float]:
    with tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder:
        site_path = write_site(Path(folder), backend)
        with Launcher(site_path, only=("router", "chain", "bridge")) as launcher:
            site = launcher.site
            contracts.run(site, threading.Event())
            bus = Bus.open(site.bus.router, timeout_s=60.0)
            wait_ready(bus, site.org)
            client = ChainClient(site.chain.url, Deployment.load(site.data_dir, CHAIN_ID))
            try:
                return _event_latency(bus, site.org, client) | _throughput(bus, site.org, client)
            finally:
                bus.close()


def _event_latency(bus: Bus, org: str, client: ChainClient) -> dict[str, float]:
    heard: dict[str, float] = {}
    everything = threading.Event()

    def on_approval(_key: str, data: dict[str, object]) -> None:
        heard[str(data["tx_hash"])] = time.perf_counter()
        if len(heard) == EVENTS:
            everything.set()

    subscriber = bus.subscribe_json(topics.EVENT.name(org=org, event="Approval"), on_approval)
    known: dict[str, float] = {}
    pace = threading.Event()
    for raw in _signed_approvals(client, EVENTS):
        tx_hash = client.w3.eth.send_raw_transaction(raw).to_0x_hex()
        known[tx_hash] = time.perf_counter()
        pace.wait(_PACE_S)
    if not everything.wait(120.0):
        raise RuntimeError(f"{EVENTS - len(heard)} of {EVENTS} events were not heard")
    subscriber.undeclare()
    latencies_ms = [1e3 * (heard[tx_hash] - known[tx_hash]) for tx_hash in known]
    percentiles = statistics.quantiles(latencies_ms, n=100)
    return {"event_latency_ms_p50": percentiles[49], "event_latency_ms_p99": percentiles[98]}


def _throughput(bus: Bus, org: str, client: ChainClient) -> dict[str, float]:
    participant = Participant(bus, org, "organization")

    def transfer(_number: int) -> None:
        participant.command("transfer", Transfer(to="panther1", amount_iec=Decimal("0.001")))

    def bridged_s(count: int) -> float:
        started_s = time.perf_counter()
        with ThreadPoolExecutor(CALLERS) as callers:
            list(callers.map(transfer, range(count)))
        return time.perf_counter() - started_s

    def bare_s(count: int) -> float:
        started_s = time.perf_counter()
        sent = [client.w3.eth.send_raw_transaction(raw) for raw in _signed_transfers(client, count)]
        for tx_hash in sent:
            client.w3.eth.wait_for_transaction_receipt(tx_hash, poll_latency=0.01)
        return time.perf_counter() - started_s

    transfer(0)
    # In turns, so that whatever else the machine does slows both.
    turns = 5
    both = [(bridged_s(TRANSACTIONS // turns), bare_s(TRANSACTIONS // turns)) for _ in range(turns)]
    bridged, bare = (TRANSACTIONS / sum(times) for times in zip(*both, strict=True))
    return {"tx_per_s": bridged, "tx_per_s_bare": bare, "tx_throughput": bridged / bare}


def _quorum_verdict_ms() -> float:
    """Three of five oracles have to agree, and two have voted. The oracles' own code signs and posts."""
    names = ("anna", "bert", "carl", "dora", "erin")
    extra = "".join(f'\n[[oracles]]\nname = "{name}"\n' for name in names)
    with tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder:
        site_path = write_site(Path(folder), "eth-tester", extra)
        with Launcher(site_path, only=("router", "chain", "bridge")) as launcher:
            site = launcher.site
            contracts.run(site, threading.Event())
            with Bus.open(site.bus.router, timeout_s=60.0) as bus:
                wait_ready(bus, site.org)
                return statistics.median(_verdicts_ms(site, bus, names[:3]))


def _verdicts_ms(site: Site, bus: Bus, names: Sequence[str]) -> Iterator[float]:
    """From the third vote's publication to the payment, as a subscriber of the bus sees it."""
    stop, settled, waiting = threading.Event(), threading.Event(), set[tuple[int, int]]()
    heard = threading.Event()
    subscribers = [
        bus.subscribe_json(topics.EVENT.name(org=site.org, event="TaskSettled"), lambda *_: settled.set()),
        bus.subscribe_json(topics.VOTE.pattern(org=site.org), lambda *_: heard.set()),
    ]

    def oracle(name: str) -> Votes:
        wallet, key = Participant(bus, site.org, name), wallets.load(site, f"{name}-device")
        return Votes(
            *(site, name, Voters(site, key, wallet), bus, wallet, WallClock()),
            waits=lambda task_id, attempt: (task_id, attempt) in waiting,
            tell=lambda: None,
        )

    oracles = [oracle(name) for name in names]
    working = [threading.Thread(target=one.run, args=(stop,), daemon=True) for one in oracles]
    for thread in working:
        thread.start()
    robot, organization = (Participant(bus, site.org, name) for name in ("panther1", "organization"))
    robot.command("register_service", RegisterService(kind=KIND, price_iec=Decimal(1)))
    params = {"item_id": "item1", "x_m": 1.0, "y_m": 2.0}
    digest = "ab" * 32
    for _ in range(VERDICTS):
        posted = RegisterTask(kind=KIND, reward_iec=Decimal(1), params=params)
        task_id = organization.command("register_task", posted).task_id or 0
        robot.submit_proof(task_id, 1, f"0x{digest}", f"{site.store_url}/{digest}.mcap")
        task = robot.task(task_id)
        vote = Vote(
            task_id=task_id,
            attempt=1,
            proof_sha256=f"0x{digest}",
            report_sha256=f"0x{digest}",
            rules_sha256=task.rules_sha256 or "",
            ruling="accepted",
            amount_iec=Decimal(1),
            reason="accepted",
        )
        waiting.add((task_id, 1))
        settled.clear()
        *others, last = oracles
        for one in others:
            heard.clear()
            one.cast(task, vote, "file:///report.json")
            heard.wait(60.0)
        started_s = time.perf_counter()
        last.cast(task, vote, "file:///report.json")
        if not settled.wait(60.0):
            raise RuntimeError(f"task {task_id} was not settled")
        yield 1e3 * (time.perf_counter() - started_s)
        waiting.clear()
    stop.set()
    for thread in working:
        thread.join()
    for subscriber in subscribers:
        subscriber.undeclare()


def _index_from_nothing(tasks: int) -> float:
    """Tasks of `past.history`, in blocks of one transaction."""
    someone, robot, manager = ("0x" + digit * 40 for digit in "123")
    minted = events.Transfer(ZERO_ADDRESS, someone, tasks * past.IEC)
    happened = [[past.offered(robot), minted]]
    for number in range(1, tasks + 1):
        happened += past.history(number, someone, robot, manager)
    logs = [
        TimedLog(Log(event, manager, block, f"0x{block:064x}", place, f"0x{block:064x}"), block)
        for block, in_block in enumerate(happened)
        for place, event in enumerate(in_block)
    ]
    with tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder:
        index = Index(sqlite_url(Path(folder) / "index.sqlite"), CHAIN_ID, "0x", {"TaskManager": manager})
        started_s = time.perf_counter()
        for first in range(0, len(happened), MAX_BLOCKS):
            last = min(first + MAX_BLOCKS, len(happened)) - 1
            page = [one for one in logs if first <= one.log.block <= last]
            index.apply(page, Position(last, f"0x{last:064x}", last), head=len(happened))
        took_s = time.perf_counter() - started_s
        index.close()
    return took_s


def _signed_transfers(client: ChainClient, count: int) -> Iterator[bytes]:
    return _signed(client, client.calls.transfer(client.organization, 0), count)


def _signed_approvals(client: ChainClient, count: int) -> list[bytes]:
    return list(_signed(client, client.calls.approve(client.organization, 1), count))


def _signed(client: ChainClient, call: Call, count: int) -> Iterator[bytes]:
    account = Account.from_key(DEV_KEY)
    first = client.w3.eth.get_transaction_count(account.address)
    for offset in range(count):
        yield bytes(
            account.sign_transaction(
                {
                    "type": 2,
                    "chainId": CHAIN_ID,
                    "nonce": first + offset,
                    "to": call.to,
                    "data": call.data,
                    "gas": 100_000,
                    "maxFeePerGas": 10**10,
                    "maxPriorityFeePerGas": 10**9,
                }
            ).raw_transaction
        )


def wait_ready(bus: Bus, org: str) -> None:
    ready = threading.Event()

    def on_status(_key: str, data: dict[str, object]) -> None:
        if data["ready"]:
            ready.set()

    subscriber = bus.subscribe_json(topics.STATUS.name(org=org, process="bridge"), on_status)
    if not ready.wait(60.0):
        raise RuntimeError("the bridge did not get ready")
    subscriber.undeclare()


def write_site(folder: Path, backend: str, extra: str = "") -> Path:
    """The lab on free ports with its data in `folder`; `extra` is TOML of its own."""
    path = folder / "site.toml"
    path.write_text(
        f"""extends = {json.dumps(str(SITE))}
data_dir = {json.dumps(str(folder / "data"))}
chain.url = "http://127.0.0.1:{free_port()}"
chain.backend = "{backend}"
{extra}
"""
    )
    return path
