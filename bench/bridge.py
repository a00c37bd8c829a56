"""The bridge on the embedded chain: how soon an event is heard, how many transactions it gets through.

`event_latency_ms_*`: from the node's answer to eth_sendRawTransaction (it has the block then) to the message
at a subscriber of the bus, for transactions that the bridge knows nothing of.
`tx_per_s`: commands answered per second, each wallet sending one after the other, all at once.
`tx_per_s_bare`: signed transactions that the same node takes per second from one client of its own.
"""

from __future__ import annotations

import json
import socket
import statistics
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from pathlib import Path

from eth_account import Account

from deploy import contracts
from deploy.launcher import Launcher
from rodeo.bus import Bus
from rodeo.chain import ChainClient, Deployment
from rodeo.dao import Participant
from rodeo.messages import Transfer

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
CHAIN_ID = 31_337
DEV_KEY = "0xac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80"
"""First account of the public test mnemonic, which every local chain funds."""

EVENTS = 200
TRANSACTIONS = 60
_PACE_S = 0.013
"""Between two events: coprime with the bridge's polling period, so that all its phases are hit."""


def run() -> dict[str, float]:
    """Measure on a site of its own, on free ports, in a folder that is removed."""
    with tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder:
        site_path = _write_site(Path(folder))
        with Launcher(site_path, only=("router", "chain", "bridge")) as launcher:
            site = launcher.site
            contracts.run(site, threading.Event())
            bus = Bus.open(site.bus.router, timeout_s=30.0)
            _wait_ready(bus, site.org)
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

    subscriber = bus.subscribe_json(f"rodeo/{org}/event/Approval", on_approval)
    known: dict[str, float] = {}
    pace = threading.Event()
    for raw in _signed_approvals(client, EVENTS):
        tx_hash = client.w3.eth.send_raw_transaction(raw).to_0x_hex()
        known[tx_hash] = time.perf_counter()
        pace.wait(_PACE_S)
    if not everything.wait(30.0):
        raise RuntimeError(f"{EVENTS - len(heard)} of {EVENTS} events were not heard")
    subscriber.undeclare()
    latencies_ms = [1e3 * (heard[tx_hash] - known[tx_hash]) for tx_hash in known]
    percentiles = statistics.quantiles(latencies_ms, n=100)
    return {"event_latency_ms_p50": percentiles[49], "event_latency_ms_p99": percentiles[98]}


def _throughput(bus: Bus, org: str, client: ChainClient) -> dict[str, float]:
    def transfers(name: str, to: str) -> None:
        participant = Participant(bus, org, name)
        for _ in range(TRANSACTIONS):
            participant.command("transfer", Transfer(to=to, amount_iec=Decimal("0.001")))

    started_s = time.perf_counter()
    with ThreadPoolExecutor() as wallets:
        for done in [
            wallets.submit(transfers, "organization", "panther1"),
            wallets.submit(transfers, "panther1", "organization"),
        ]:
            done.result()
    bridged_s = time.perf_counter() - started_s
    raws = _signed_approvals(client, 2 * TRANSACTIONS)
    started_s = time.perf_counter()
    for raw in raws:
        client.w3.eth.send_raw_transaction(raw)
    bare_s = time.perf_counter() - started_s
    return {"tx_per_s": 2 * TRANSACTIONS / bridged_s, "tx_per_s_bare": 2 * TRANSACTIONS / bare_s}


def _signed_approvals(client: ChainClient, count: int) -> list[bytes]:
    account = Account.from_key(DEV_KEY)
    first = client.w3.eth.get_transaction_count(account.address)
    call = client.calls.approve(client.organization, 1)
    return [
        bytes(
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
        for offset in range(count)
    ]


def _wait_ready(bus: Bus, org: str) -> None:
    ready = threading.Event()

    def on_status(_key: str, data: dict[str, object]) -> None:
        if data["ready"]:
            ready.set()

    subscriber = bus.subscribe_json(f"rodeo/{org}/status/bridge", on_status)
    if not ready.wait(60.0):
        raise RuntimeError("the bridge did not get ready")
    subscriber.undeclare()


def _write_site(folder: Path) -> Path:
    path = folder / "site.toml"
    path.write_text(
        f"""extends = {json.dumps(str(SITE))}
data_dir = {json.dumps(str(folder / "data"))}
bus.router = "tcp/127.0.0.1:{_free_port()}"
chain.url = "http://127.0.0.1:{_free_port()}"
"""
    )
    return path


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])
