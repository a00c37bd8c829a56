"""Gas and sizes of the contracts: what a task costs, whether history makes it dearer, and what griefers can
do.

`contracts/bench/Gas.t.sol` measures in Foundry's EVM, where ten thousand tasks take seconds. The figures of a
step (`gas_register`, `gas_proof`, `gas_verdict`) are those of the ten thousandth task.
`contracts/bench/Griefing.t.sol` measures attackers of a grid under each matching policy; `griefing_...`
without a policy's name is the worst of all. `griefed_by_...` are the tasks that failed at single points, also
of accounts that proved themselves before; proving one takes `proving_gas` and three accepted tasks.
`founding` is what `rodeo site prepare` sends to an empty chain. `python -m bench.contracts` writes the table
of docs/reference/contracts.md from `out/bench.json`."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

from deploy import contracts
from deploy.chain.local_chain import LocalChain
from deploy.chain.methods import Methods
from deploy.chain.server import RpcServer
from deploy.chain.store import Store
from rodeo.chain import artifacts
from rodeo.chain.client import connect
from rodeo.errors import snake_case
from rodeo.signing import keystores
from rodeo.site.config import Site
from tests.support.site import free_port

ETH_EUR = 3700.0
GAS_GWEI = {"Ethereum": 1.0, "Arbitrum One": 0.01, "Base": 0.005}
"""Assumed, not measured: both change by the hour. The page of the contracts says what gas costs by them."""


def euros(gas: float, network: str) -> float:
    """What gas costs there, without what a rollup charges for publishing data."""
    return gas * GAS_GWEI[network] * 1e-9 * ETH_EUR


STEPS = {
    "post a task, with matching": "gas_register",
    "hand in the proof": "gas_proof",
    "verdict and payment": "gas_verdict",
    "**a task from beginning to end**": "gas_lifecycle_10000",
    "verdict by three of five judges": "gas_verdict_quorum_3_of_5",
    "verdict that can be challenged, and its conclusion": "gas_verdict_with_window",
    "the same with a challenge, its answer and the settlement": "gas_dispute",
    "post a task for which nobody is free": "gas_register_queued",
    "cancel a task": "gas_cancel",
    "offer a service": "gas_register_service",
    "registry and all contracts, set up for one robot": "gas_founding_first",
    "another organization on the same chain": "gas_founding_second",
}
"""What the page of the contracts calls a figure."""

_ROOT = Path(__file__).parents[1]
_FIGURES = _ROOT / "contracts" / "out" / "snapshots" / "contracts.json"


def run() -> dict[str, float]:
    """Gas per transaction and runtime code sizes. Raises CalledProcessError with forge's output."""
    subprocess.run(
        ["node", "contracts/forge.mjs", "test"],
        cwd=_ROOT,
        env={**os.environ, "FOUNDRY_PROFILE": "bench"},
        capture_output=True,
        check=True,
    )
    gas = {name: float(value) for name, value in json.loads(_FIGURES.read_text()).items()}
    sizes = {
        f"size_{snake_case(name)}_bytes": float(len(artifacts.load(name).deployed_code))
        for name in artifacts.CONTRACTS
    }
    return griefing(gas) | sizes | founding(Site.load(_ROOT / "deploy/sites/testnet.toml"))


def founding(site: Site) -> dict[str, float]:
    """Gas of all transactions that found the site's organization on an empty chain, and another one there.
    Raises what `contracts.run` raises."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        folder, url, now_s = Path(name), f"http://127.0.0.1:{free_port()}", 1_700_000_000
        chain = site.chain.model_copy(update={"url": url, "backend": "eth-tester", "id": 31_337})
        with (
            closing(Store(folder / "chain.sqlite")) as store,
            RpcServer(url, Methods(LocalChain(store, chain.id, now_s, lambda: now_s))),
        ):
            w3 = connect(url)
            for org in ("first", "second"):
                (folder / org).mkdir()
                changes = {"chain": chain, "org": org, "data_dir": folder / org}
                one, began = site.model_copy(update=changes), w3.eth.block_number
                contracts.run(one, threading.Event())
                senders = {keystores.address(one, wallet) for wallet in keystores.wallet_names(one)}
                found[f"gas_founding_{org}"] = float(
                    sum(
                        receipt["gasUsed"]
                        for number in range(began + 1, w3.eth.block_number + 1)
                        for receipt in w3.eth.get_block_receipts(number)
                        if receipt["from"] in senders
                    )
                )
    return found


def table(figures: Mapping[str, float]) -> str:
    """Steps, their gas, and what it costs on each network. Raises KeyError for a figure that is missing."""
    lines = ["| step | gas | " + " | ".join(f"{name}, EUR" for name in GAS_GWEI) + " |", "|---" * 5 + "|"]
    for step, figure in STEPS.items():
        gas = round(figures[figure])
        costs = " | ".join(f"{euros(gas, name):.{digits}f}" for name, digits in _DIGITS.items())
        lines.append(f"| {step} | {gas:,} | {costs} |")
    return "\n".join(lines)


_DIGITS = {"Ethereum": 3, "Arbitrum One": 4, "Base": 4}


_WORST = {
    "griefing_tasks_failed": max,
    "griefing_delay_p95_min": max,
    "griefing_honest_income_share": min,
    "griefing_match_gas_max": max,
    "newcomer_first_task_h": max,
    "named_delay_p95_min": max,
    **{f"griefed_by_{number}_proven": max for number in (2, 8, 50)},
}
"""Figure -> which of the policies' is the worst."""


def griefing(figures: Mapping[str, float]) -> dict[str, float]:
    """The same figures, with shares in place of thousandths, and the worst of all policies. Raises KeyError
    where one of `_WORST` is missing."""
    told = {
        name.replace("_permille_", "_share_"): value / 1000 if "_permille_" in name else value
        for name, value in figures.items()
    }
    for name, worst in _WORST.items():
        found = [value for other, value in told.items() if other.startswith(f"{name}_")]
        if not found:
            raise KeyError(name)
        told[name] = float(worst(found))
    return told


if __name__ == "__main__":
    print(table(json.loads((_ROOT / "out/bench.json").read_text())))
