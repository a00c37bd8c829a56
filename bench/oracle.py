"""From URI to verdict, as the oracle does it: fetched from the store, verified in a process of its own.

`verify_cleaning_s`: a 192 s cleaning at 50 Hz (eight topics), replayed in physics at 2 ms, wall time.
`verify_driving_s`: one of `verified_driving_s` in which the robot drives round and round with the item while
its arm sways: the other one mostly stands still, and what lies still is not stepped.
`verify_cleaning_<length>s_cpu_s`: CPU time of verifying 48, 96, 192 and 384 s. `verify_growth`: what another
second costs between 192 and 384 s, over what it costs between 96 and 192 s; 1 is linear.
`verify_charging_s`: a 65-minute charge, for which meter and robot signed every 2.5 Wh.
`verify_peak_mb`: largest resident memory of a process that verifies the 192 s cleaning,
`verify_charging_peak_mb` and `verify_cleaning_384s_peak_mb` of processes that verify the others.
`verify_cpu_s` and `verify_charging_cpu_s`: CPU time of a verification without the start of its process.
`proof_to_verdict_s`: on a running site (router, chain, bridge and oracle as processes), wall time from the
event of a submission's block to that of its verdict's: the worst of `proof_to_verdict_first_s`, the first
after the oracle's start, and of the median of later ones, `proof_to_verdict_later_s`.
"""

from __future__ import annotations

import multiprocessing
import statistics
import tempfile
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path

from eth_account.signers.local import LocalAccount

from bench.memory import peak_mb
from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import DaoEvents
from rodeo.checks.case import ChainRecord
from rodeo.checks.verify import verify_submission
from rodeo.dao import Participant
from rodeo.evidence.seal import Binding
from rodeo.evidence.store import Store
from rodeo.jobs.apart import verify_apart
from rodeo.signing import wallets
from rodeo.site.config import Site
from rodeo_kinds.battery_charging.harness.film import charging_chain_record, film_charging
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning
from rodeo_testing.assignments import BINDING, CHARGE_BINDING, METER, ROBOT
from rodeo_testing.recordings import Take, Witnesses, later, seal
from tests.support.dao import Dao, founded
from tests.support.site import write_site

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
CLEANING_S = 192.0
LENGTHS_S = (48.0, 96.0, CLEANING_S, 384.0)
ROUND = (4.7, 1.7), (5.2, 3.4)
"""Places to pass on the way to the bin."""
ROUNDS = 8
SWAY_RAD = 0.1
"""By how much each joint of the arm sways while it drives."""
CHARGED_FROM = 0.525
"""State of charge from which a charge takes 65 minutes."""
REPEATS = 5
SUBMISSIONS = 6


def run() -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        site = Site.load(SITE).model_copy(update={"data_dir": Path(folder, "data")})
        brief = film_cleaning(site, "item1")
        films = {
            length_s: film_cleaning(site, "item1", linger_s=length_s - (brief.end_s - brief.start_s))
            for length_s in LENGTHS_S
        }
        cleaning = films[CLEANING_S]
        driving = film_cleaning(site, "item1", via=ROUND * ROUNDS, sway_rad=SWAY_RAD)
        charge = film_charging(site, soc=CHARGED_FROM)
        cases = {
            "cleaning": _submitted(site, cleaning, cleaning_chain_record(cleaning), BINDING, ROBOT),
            "driving": _submitted(site, driving, cleaning_chain_record(driving), BINDING, ROBOT),
            "charging": _submitted(
                site, charge, charging_chain_record(charge, {"soc_from": CHARGED_FROM}), CHARGE_BINDING, METER
            ),
        }
        figures = {
            "verified_cleaning_s": cleaning.end_s - cleaning.start_s,
            "verified_driving_s": driving.end_s - driving.start_s,
            "verified_charging_s": charge.end_s - charge.start_s,
        }
        for name, chain_record in cases.items():
            _verify(site, chain_record)  # the first starts what later ones share
            figures[f"verify_{name}_s"] = statistics.median(
                _verify(site, chain_record) for _ in range(REPEATS)
            )
        figures["verify_charging_cpu_s"], figures["verify_charging_peak_mb"] = _cost(site, cases["charging"])
        cpu_s = {}
        for length_s, film in films.items():
            chain_record = _submitted(site, film, cleaning_chain_record(film), BINDING, ROBOT)
            cpu_s[length_s], peak_mb = _cost(site, chain_record)
            figures[f"verify_cleaning_{length_s:.0f}s_cpu_s"] = cpu_s[length_s]
            if length_s >= CLEANING_S:
                figures[f"verify_cleaning_{length_s:.0f}s_peak_mb"] = peak_mb
        figures["verify_cpu_s"] = cpu_s[CLEANING_S]
        figures["verify_peak_mb"] = figures.pop("verify_cleaning_192s_peak_mb")
        figures["verify_growth"] = (cpu_s[384.0] - cpu_s[192.0]) / (cpu_s[192.0] - cpu_s[96.0]) / 2
        return figures | proof_to_verdict()


def proof_to_verdict() -> dict[str, float]:
    """Submit honest proofs, one after another, on a site of real processes."""
    with tempfile.TemporaryDirectory() as folder, founded(write_site(Path(folder)), "oracle") as dao:
        dao.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
        devices = "itrash", "panther1", "mocap"
        keys = {name: wallets.load(dao.site, f"{name}-device") for name in devices}
        film = film_cleaning(dao.site, "item1")
        films = [later(film, 120 * number) for number in range(1, 1 + SUBMISSIONS)]
        took_s = [_verdict_s(dao, keys, take) for take in films]
    later_s = statistics.median(took_s[1:])
    return {
        "proof_to_verdict_s": max(took_s[0], later_s),
        "proof_to_verdict_first_s": took_s[0],
        "proof_to_verdict_later_s": later_s,
    }


def _verdict_s(dao: Dao, keys: dict[str, LocalAccount], take: Take) -> float:
    """Wall time from the block of a submission of `take` to that of its verdict."""
    executor = Participant(dao.running.bus, dao.site.org, "panther1")
    dao.set_clock(take.start_s - 5)
    task = executor.task(dao.post(params={"item_id": "item1", "x_m": 4.6, "y_m": 1.2}))
    with tempfile.TemporaryDirectory() as folder:
        witnesses = Witnesses(mocap=keys["mocap"], bin=keys["itrash"], robot=keys["panther1"])
        binding = executor.binding(task, "panther1")
        proof = seal(take, Path(folder, "proof.mcap"), binding, keys["panther1"], witnesses)
        uri = Store(dao.site).put(proof.path)
    dao.set_clock(take.end_s + 5)
    heard_s: dict[str, float] = {}

    def on_event(event: DaoEvent) -> None:
        if event.task_id == task.id:
            heard_s.setdefault(event.name, time.perf_counter())

    with DaoEvents(dao.running.bus, dao.site.org, on_event, after_seq=dao.events[-1].seq):
        executor.submit_proof(task.id, task.attempt, proof.sha256, uri)
        dao.wait_for(lambda: "TaskSettled" in dao.names_of(task.id), f"the payment of task {task.id}")
        dao.catch_up()
    return heard_s["Ruled"] - heard_s["ProofSubmitted"]


def _submitted(
    site: Site, take: Take, chain_record: ChainRecord, binding: Binding, device: LocalAccount
) -> ChainRecord:
    """The chain's view after the proof of `take` was put into the store."""
    with tempfile.TemporaryDirectory() as folder:
        proof = seal(take, Path(folder, "proof.mcap"), binding, device)
        fields = {"proof_uri": Store(site).put(proof.path), "proof_sha256": proof.sha256}
    return chain_record.model_copy(update={"task": chain_record.task.model_copy(update=fields)})


def _verify(site: Site, chain_record: ChainRecord) -> float:
    """Wall time of one verification, s."""
    started_s = time.perf_counter()
    report = verify_apart(site, chain_record, site.data_dir / "verifying", threading.Event())
    if report is None or not report.accepted:
        raise RuntimeError(f"an honest proof was refused: {report and report.reason}")
    return time.perf_counter() - started_s


def _cost(site: Site, chain_record: ChainRecord) -> tuple[float, float]:
    """CPU time in s, median, and peak memory in MB of a process that verifies."""
    receiver, sender = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("spawn").Process(target=_measure, args=(site, chain_record, sender))
    child.start()
    cost: tuple[float, float] = receiver.recv()
    child.join()
    return cost


def _measure(site: Site, chain_record: ChainRecord, sender: Connection) -> None:
    spent_s, peak = [], 0.0
    for number in range(REPEATS):
        with tempfile.TemporaryDirectory() as folder:
            started_s = time.process_time()
            verify_submission(site, chain_record, Path(folder))
            spent_s.append(time.process_time() - started_s)
        if number == 0:
            peak = peak_mb()
    sender.send((statistics.median(spent_s), peak))
