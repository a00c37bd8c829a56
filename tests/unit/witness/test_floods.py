"""Every seal of an honest recording is listed, whatever somebody else publishes meanwhile."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account

from rodeo.evidence.seal import Binding, RunningHash, SealChain
from rodeo.host.budget import CheckBudget
from rodeo.witness import witness as witness_module
from rodeo.witness.chain import WitnessChain
from rodeo.witness.heads import RECORDINGS, HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import MAX_HEADS, Head, Presentation
from rodeo.witness.witness import AHEAD_S, Witness
from rodeo_testing.waiting import wait_until
from tests.unit.witness.test_witness import BINDING, MOCAP, NOW_S, RIVAL, ROBOT, Bus, forged

STATEMENTS = 30
VICTIM, ATTACKER = "panther1", "panther2"
OWN_SESSION, OTHER_SESSION = "1a", "2b"


class Recorder:
    """Seals one recording of a device."""

    def __init__(self, device: str = VICTIM, account: Any = ROBOT, task_id: int = 1) -> None:
        update = {"device": device, "task_id": task_id}
        self._chain = SealChain(Binding.model_validate(BINDING.model_dump() | update), account)
        self._running = RunningHash()

    def seal(self, time_s: float) -> bytes:
        self._running.messages += 50
        return self._chain.next(self._running, round(time_s * 1e9))


class Bench:
    """A witness whose clock and bus are in the test's hands; the wall's clock goes with the site's."""

    def __init__(self, bus: Bus, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bus = bus
        self.folder = folder
        self.time_s = float(NOW_S)
        self.checks = 0
        verify = witness_module.verify_attestation

        def counted(attestation: Any) -> str:
            self.checks += 1
            return verify(attestation)

        monkeypatch.setattr(witness_module, "verify_attestation", counted)
        now_ns: Callable[[], int] = lambda: round(self.time_s * 1e9)  # noqa: E731
        self.witness = Witness(bus, "lab", "mocap", MOCAP, folder, "sensor", now_ns)  # type: ignore[arg-type]
        self.witness.checks.budget = CheckBudget(100.0, lambda: self.time_s)
        wait_until(lambda: self.witness.chain is not None and self.witness.devices.answered)

    def hear(self, data: bytes, device: str = VICTIM, source: str = OWN_SESSION) -> None:
        self.bus.hear["seal"](f"rodeo/lab/seal/{device}", data, source)

    def listed(self) -> list[str]:
        return [head.digest for head in self.witness.heads.take()]

    def listed_of(self, rate_hz: int, attack: Callable[[int], None], recorder: Recorder) -> int:
        """In how many of 30 statements the newest seal is listed: `attack(number)` is called so often in each
        second, before and after the seal. The site is a little faster where that is much."""
        found = 0
        self.hear(recorder.seal(self.time_s))
        self.listed()
        at_once = min(rate_hz, 400)
        for _ in range(STATEMENTS):
            newest = b""
            for number in range(at_once):
                if number == at_once // 2:
                    newest = recorder.seal(self.time_s)
                    self.hear(newest)
                attack(number)
                self.time_s += 1.0 / rate_hz
            found += digest(newest) in self.listed()
        return found


def digest(seal: bytes) -> str:
    (head,) = [witness_module.unverified_seal(seal).spoken.head]
    return head.digest


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    bench = Bench(Bus(), tmp_path, monkeypatch)
    yield bench
    bench.witness.close()


def old_seals(count: int = 3, since_s: float = 3600.0) -> list[bytes]:
    """Seals of earlier recordings of the victim, as they stand in its public proofs."""
    return [Recorder(task_id=100 + number).seal(NOW_S - since_s + number) for number in range(count)]


@pytest.mark.parametrize("key", [ATTACKER, VICTIM])
@pytest.mark.parametrize("rate_hz", [3, 150])
def test_old_seals_push_no_running_recording_out(bench: Bench, key: str, rate_hz: int) -> None:
    """On the attacker's own key, and on an open bus on the victim's."""
    old = old_seals()

    def replay(number: int) -> None:
        bench.hear(old[number % 3], key, OTHER_SESSION)

    assert bench.listed_of(rate_hz, replay, Recorder(task_id=200)) == STATEMENTS
    assert bench.checks == STATEMENTS + 1 + (0 if key == ATTACKER else len(old))


@pytest.mark.parametrize("rate_hz", [150, 2000])
def test_bad_signatures_on_another_key_cost_no_check(bench: Bench, rate_hz: int) -> None:
    bad = forged(Recorder(task_id=300).seal(NOW_S + 20))

    def flood(_number: int) -> None:
        bench.hear(bad, ATTACKER, OTHER_SESSION)

    assert bench.listed_of(rate_hz, flood, Recorder(task_id=200)) == STATEMENTS
    assert bench.checks == STATEMENTS + 1


@pytest.mark.long
@pytest.mark.parametrize("rate_hz", [150, 2000])
def test_bad_signatures_on_the_victims_key_use_up_what_strangers_share(bench: Bench, rate_hz: int) -> None:
    """On an open bus: each claims a recording of its own, sealed just now."""
    bad = forged(Recorder(task_id=300).seal(NOW_S + 20))
    signature = json.loads(bad)["signature"].encode()
    count = itertools.count()

    def flood(_number: int) -> None:
        bench.hear(bad.replace(signature, b"0x%0128x1b" % next(count)), VICTIM, OTHER_SESSION)

    bench.time_s += 10
    began_s = bench.time_s
    assert bench.listed_of(rate_hz, flood, Recorder(task_id=200)) == STATEMENTS
    assert bench.checks <= STATEMENTS + 1 + 100 * (1 + bench.time_s - began_s)


def test_a_forgery_said_again_is_not_checked_again(bench: Bench) -> None:
    """Also by whoever takes the victim's session, which is not told apart."""
    bad = forged(Recorder(task_id=300).seal(NOW_S + 10))
    recorder = Recorder(task_id=200)
    assert bench.listed_of(150, lambda _number: bench.hear(bad), recorder) == STATEMENTS
    assert bench.checks == STATEMENTS + 2


def test_a_seal_said_again_is_not_checked_again(bench: Bench) -> None:
    recorder = Recorder()
    seals = [recorder.seal(NOW_S - back) for back in (2, 1)]
    for seal in (*seals, *seals, *seals):
        bench.hear(seal)
    assert (bench.checks, len(bench.listed())) == (2, 1)
    for seal in seals:
        bench.hear(seal)
    assert (bench.checks, bench.listed()) == (2, [])


def test_what_is_sealed_at_a_time_to_come_is_not_heard(bench: Bench) -> None:
    bench.hear(Recorder(task_id=1).seal(NOW_S + AHEAD_S + 0.001))
    bench.hear(Recorder(task_id=2).seal(NOW_S + 1e9))
    assert (bench.checks, bench.listed()) == (0, [])
    bench.hear(Recorder(task_id=3).seal(NOW_S + AHEAD_S))
    assert len(bench.listed()) == 1


@pytest.mark.parametrize("time_ns", ["", "-1", "1e9", "soon", "\u0661", "9" * 20, "9" * 5000])
def test_a_time_that_is_none_is_no_seal(bench: Bench, time_ns: str) -> None:
    signed = json.loads(Recorder().seal(NOW_S))
    signed["payload"]["time_ns"] = time_ns
    bench.hear(json.dumps(signed).encode())
    assert bench.checks == 0


def test_a_clock_that_was_put_back_forgets_what_it_heard_of_times_to_come(bench: Bench) -> None:
    bench.time_s += 86_400
    for task_id in range(3):
        bench.hear(Recorder(task_id=task_id).seal(bench.time_s + task_id))
    bench.listed()
    bench.time_s -= 86_400
    now = Recorder(task_id=9).seal(bench.time_s)
    bench.hear(now)
    assert digest(now) in bench.listed()


def test_of_recordings_of_one_time_the_last_one_counts_and_none_comes_back(bench: Bench) -> None:
    old = [Recorder(task_id=number).seal(NOW_S) for number in range(RECORDINGS)]
    running = Recorder(task_id=9)
    newest = running.seal(NOW_S)
    for seal in (*old, newest, *old, *old):
        bench.hear(seal)
    assert digest(newest) in bench.listed()
    for later_s in (0.0, 0.001, 1.0):
        newest = running.seal(NOW_S + later_s)
        for seal in (*old, newest, *old):
            bench.hear(seal)
        assert bench.listed() == [digest(newest)]


def test_the_running_recording_is_listed_among_many_of_its_device(bench: Bench) -> None:
    """Also by a witness that has just begun to listen, and hears the old ones first."""
    many = old_seals(500)
    for seal in many:
        bench.hear(seal)
        bench.time_s += 0.02
    running = Recorder(task_id=9000).seal(bench.time_s)
    bench.hear(running)
    for seal in many:
        bench.hear(seal)
    assert bench.checks <= 500 + 1
    assert bench.listed()[0] == digest(running)


def test_a_recording_that_resumed_after_a_cut_is_listed_under_its_new_numbers(bench: Bench) -> None:
    """What the last second before a power cut sealed is lost, and its numbers are given again."""
    recorder = Recorder()
    opening = recorder.seal(NOW_S - 10)
    cut = Recorder()
    cut.seal(NOW_S - 10)
    lost = [recorder.seal(NOW_S - 9 + second) for second in range(3)]
    for seal in (opening, *lost):
        bench.hear(seal)
    bench.listed()
    again = cut.seal(NOW_S - 3)
    bench.hear(again)
    assert bench.listed() == [digest(again)]


def test_of_many_devices_each_ones_running_recording_is_listed_first() -> None:
    heads = HeadBook()

    def head(device: int, chain: int | None, index: int) -> Head:
        return Head(
            device=f"robot{device}",
            address=f"0x{device:040x}",
            chain=None if chain is None else f"0x{device:032x}{chain:032x}",
            index=index,
            digest=f"0x{device:032x}{index:032x}",
        )

    for second in range(1, 10):
        for device in range(MAX_HEADS):
            heads.hear(head(device, None, second))
            heads.hear(head(device, 1, 1), 1)
            heads.hear(head(device, 2, second), 10**9 * second)
        listed = heads.take()
        assert len(listed) == MAX_HEADS
        assert {one.address for one in listed if one.index == second and one.chain is not None} == {
            f"0x{device:040x}" for device in range(MAX_HEADS)
        }
        assert heads, "the rest waits"


def test_of_more_devices_than_fit_whoever_waited_longest_is_listed() -> None:
    heads = HeadBook()
    times = dict.fromkeys(range(2 * MAX_HEADS), 0)
    for second in range(10):
        for number in times:
            one = Head(
                device=f"robot{number}",
                address=f"0x{number:040x}",
                chain=f"0x{number:064x}",
                index=second,
                digest=f"0x{second:064x}",
            )
            heads.hear(one, second)
        for listed in heads.take():
            times[int(listed.address, 16)] += 1
    assert set(times.values()) == {5}


def test_a_session_that_signed_badly_shares_with_strangers_again() -> None:
    now_s = 0.0
    budget = CheckBudget(2.0, lambda: now_s)
    assert budget.take("key", "own")
    budget.checked("key", "own", genuine=True)
    assert [budget.take("key", "other") for _ in range(3)] == [True, False, False]
    assert budget.take("other key", "other")
    assert [budget.take("key", "own") for _ in range(3)] == [True, True, False]
    budget.checked("key", "own", genuine=False)
    now_s = 1.0
    assert [budget.take("key", who) for who in ("other", "other", "own")] == [True, True, False]


def test_a_device_that_the_bridge_does_not_know_yet_is_looked_up(bench: Bench) -> None:
    bench.bus.devices["panther3"] = Account.create()
    seal = Recorder("panther3", bench.bus.devices["panther3"]).seal(NOW_S)

    def heard() -> bool:
        bench.hear(seal, "panther3")
        return digest(seal) in bench.listed()

    wait_until(heard)


def test_a_device_speaks_for_itself_on_its_own_key(bench: Bench) -> None:
    own = Recorder(ATTACKER, RIVAL).seal(NOW_S)
    bench.hear(own, VICTIM)
    assert (bench.checks, bench.listed()) == (0, [])
    bench.hear(own, ATTACKER)
    assert bench.listed() == [digest(own)]


def test_a_device_speaks_in_nobody_elses_name(bench: Bench) -> None:
    """Neither with its own signature on its own key, nor with it on the other's key."""
    bench.hear(Recorder(VICTIM, RIVAL).seal(NOW_S), ATTACKER)
    bench.hear(Recorder(VICTIM, RIVAL).seal(NOW_S), VICTIM)
    assert (bench.checks, bench.listed()) == (0, [])


def test_statements_on_another_key_are_not_heard_and_cost_no_check(bench: Bench) -> None:
    """The victim's own, and bad ones in its name; its newest one is listed all the same."""
    scope = bench.witness.chain.scope  # type: ignore[union-attr]
    journal = Journal(bench.folder / "victim")
    victim = WitnessChain(VICTIM, ROBOT, scope, "closed_bus", journal, HeadBook())

    def state() -> bytes:
        said = {"bin": "itrash", "recording": "0x" + "ab" * 32, "task_id": 7, "attempt": 1}
        return victim.sign(Presentation, bench.time_s, **said).model_dump_json().encode()

    def hear(data: bytes, device: str) -> None:
        bench.bus.hear["witness"](f"rodeo/lab/witness/{device}/statement", data, device)

    old = state()
    bad = old.replace(json.loads(old)["signature"].encode(), b"0x" + b"11" * 64 + b"1b")
    for _ in range(3):
        for _ in range(300):
            hear(old, ATTACKER)
            hear(bad, ATTACKER)
        newest = state()
        hear(newest, VICTIM)
        assert [one.index for one in bench.witness.heads.take()] == [journal.seq]
    assert bench.checks == 3
