"""What a device signed on a day goes on chain once, whatever is away meanwhile."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account

from rodeo.bus.queries import A, Query
from rodeo.commands.devices import PostRoot
from rodeo.errors import NoResponder, RemoteError
from rodeo.evidence.errors import BadAttestation, BadStatement, StoreUnavailable
from rodeo.evidence.store import Store
from rodeo.site.config import Site
from rodeo.witness import roots
from rodeo.witness.chain import WitnessChain
from rodeo.witness.days import DAY_S, Days, SignedDay, lacks
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.roots import DailyRoots
from rodeo.witness.statement import Removal, Scope, digest
from rodeo_testing import answers
from tests.support.site import LAB

BIN, NEXT = Account.create(), Account.create()
SCOPE = Scope(chain_id=31337, task_manager="0x" + "12" * 20, organization="0x" + "34" * 20)
NOON_S = 20_000.5 * DAY_S


class Bin:
    """A witness without a bus: its journal, its days and its chain. Made again, it is as after a restart."""

    device = "itrash"

    def __init__(self, folder: Path, account: Any = BIN) -> None:
        self.journal = Journal(folder / "statements.jsonl")
        self.days = Days(folder / "days", self.journal)
        self._account = account
        self.chain = WitnessChain("itrash", account, SCOPE, "sensor", self.journal, HeadBook(), self.days)

    def say(self, time_s: float) -> str:
        said = {"compartment": "blue", "weight_n": 0.4, "after_s": time_s - 1, "settled_s": time_s}
        return digest(self.chain.sign(Removal, time_s, **said))

    def day_log(self, one: Any) -> Any:
        return self.days.signed(one, self.device, SCOPE, self._account)


class Bridge:
    """Takes one root a day for each key, unless it is away."""

    def __init__(self, time_s: float = 0.0) -> None:
        self.time_s = time_s
        self.roots: list[PostRoot] = []
        self.away = False
        self.dies_after = False
        """The answer to the next command is lost."""

    def ask(self, query: Query[A], **_parameters: Any) -> A:
        if self.away:
            raise NoResponder("no process serves this key", key=query.what)
        roots = answers.roots([one.model_dump() for one in self.roots])
        return answers.answered(query, {"chain": answers.chain(time_s=self.time_s), "roots": roots})

    def command(self, name: str, request: PostRoot) -> None:
        assert name == "post_root"
        if self.away:
            raise NoResponder("no process serves this key", key=name)
        if any((one.device, one.day) == (request.device, request.day) for one in self.roots):
            raise RemoteError("root_already_posted", "the root of that day is on chain")
        self.roots.append(request)
        if self.dies_after:
            self.dies_after = False
            raise NoResponder("no process serves this key", key=name)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site.load(LAB).model_copy(update={"data_dir": tmp_path / "site"})


@pytest.fixture
def poster(site: Site, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Bin, Bridge], DailyRoots]]:
    monkeypatch.setattr(roots, "_LOOK_WALL_S", 3600.0)
    made: list[DailyRoots] = []

    def make(witness: Bin, bridge: Bridge) -> DailyRoots:
        made.append(DailyRoots(site, bridge, witness))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for one in made:
        one.close()


def fetched(site: Site, root: PostRoot, folder: Path) -> SignedDay:
    return SignedDay.load(Store(site).fetch(root.uri, root.root, folder=folder))


def test_a_day_that_is_over_is_posted_with_its_log(site: Site, tmp_path: Path, poster: Any) -> None:
    bin, bridge = Bin(tmp_path), Bridge()
    said = [bin.say(NOON_S + second) for second in range(3)]
    roots = poster(bin, bridge)
    roots.post_due()
    assert bridge.roots == [], "the day is not over"
    bin.say(NOON_S + DAY_S)
    roots.post_due()
    (root,) = bridge.roots
    assert (root.device, root.day) == (BIN.address.lower(), 20_000)
    day = fetched(site, root, tmp_path / "fetched")
    assert (day.signer, day.log.device, day.log.day) == (BIN.address, "itrash", 20_000)
    assert (day.log.first, list(day.log.statements)) == (1, said)


def test_the_chains_time_ends_a_day_on_which_nothing_follows(tmp_path: Path, poster: Any) -> None:
    bin, bridge = Bin(tmp_path), Bridge()
    bin.say(NOON_S)
    roots = poster(bin, bridge)
    bridge.time_s = NOON_S + DAY_S / 2 + 1
    roots.post_due()
    assert bridge.roots == [], "a statement may be signed a moment after its time"
    bridge.time_s = NOON_S + DAY_S / 2 + 60
    roots.post_due()
    assert [one.day for one in bridge.roots] == [20_000]


def test_days_that_were_missed_are_posted_after_the_restart_and_never_twice(
    site: Site, tmp_path: Path, poster: Any
) -> None:
    bin, bridge = Bin(tmp_path), Bridge()
    for day in range(3):
        bin.say(NOON_S + day * DAY_S)
    poster(Bin(tmp_path), bridge).post_due()
    assert [one.day for one in bridge.roots] == [20_000, 20_001]
    again = Bin(tmp_path)
    poster(again, bridge).post_due()
    assert len(bridge.roots) == 2
    again.say(NOON_S + 3 * DAY_S)
    poster(again, bridge).post_due()
    assert [one.day for one in bridge.roots] == [20_000, 20_001, 20_002]
    logs = [fetched(site, one, tmp_path / "fetched").log for one in bridge.roots]
    assert [(one.first, one.count) for one in logs] == [(1, 1), (2, 1), (3, 1)]


def test_a_bridge_that_is_away_delays_it_and_loses_nothing(tmp_path: Path, poster: Any) -> None:
    bin, bridge = Bin(tmp_path), Bridge()
    bin.say(NOON_S)
    bin.say(NOON_S + DAY_S)
    bridge.away = True
    roots = poster(bin, bridge)
    with pytest.raises(NoResponder):
        roots.post_due()
    bridge.away = False
    roots.post_due()
    assert [one.day for one in bridge.roots] == [20_000]


def test_a_store_that_is_away_delays_it_and_loses_nothing(
    tmp_path: Path, poster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bin, bridge = Bin(tmp_path), Bridge()
    bin.say(NOON_S)
    bin.say(NOON_S + DAY_S)
    roots = poster(bin, bridge)

    def away(*_arguments: Any) -> None:
        raise StoreUnavailable("the store failed")

    with monkeypatch.context() as patch, pytest.raises(StoreUnavailable):
        patch.setattr(Store, "put_bytes", away)
        roots.post_due()
    assert bridge.roots == []
    roots.post_due()
    assert [one.day for one in bridge.roots] == [20_000]


def test_an_answer_that_was_lost_is_no_second_root(tmp_path: Path, poster: Any) -> None:
    """Killed, or cut off, after the root was on chain and before that was known."""
    bin, bridge = Bin(tmp_path), Bridge()
    bin.say(NOON_S)
    bin.say(NOON_S + DAY_S)
    bridge.dies_after = True
    with pytest.raises(NoResponder):
        poster(bin, bridge).post_due()
    restarted = Bin(tmp_path)
    poster(restarted, bridge).post_due()
    assert len(bridge.roots) == 1
    assert [one.day for one in restarted.days.unposted()] == [20_001]


def test_another_root_in_its_place_is_said_aloud(
    tmp_path: Path, poster: Any, caplog: pytest.LogCaptureFixture
) -> None:
    bin, bridge = Bin(tmp_path), Bridge()
    bin.say(NOON_S)
    bin.say(NOON_S + DAY_S)
    false = PostRoot(device=BIN.address.lower(), day=20_000, root="0x" + "ab" * 32, uri="file:///none")
    bridge.roots.append(false)
    poster(bin, bridge).post_due()
    assert "somebody posted another root" in caplog.text


def test_what_a_crash_kept_from_the_log_is_taken_from_the_journal(tmp_path: Path, poster: Any) -> None:
    bin = Bin(tmp_path)
    said = [bin.say(NOON_S + second) for second in range(4)]
    (log,) = (tmp_path / "days").glob("*.digests")
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[:2]) + lines[2][:30])
    restarted = Bin(tmp_path)
    (one,) = restarted.days.unposted()
    assert restarted.day_log(one).payload["statements"] == said


def test_a_disk_that_is_full_for_a_while_costs_no_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bin = Bin(tmp_path)
    said = [bin.say(NOON_S)]

    def full(*_arguments: Any) -> None:
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Days, "_write", full)
        said.append(bin.say(NOON_S + 1))
    said.append(bin.say(NOON_S + 2))
    (one,) = bin.days.unposted()
    assert bin.day_log(one).payload["statements"] == said


def test_a_key_that_changes_has_a_log_of_its_own(tmp_path: Path, poster: Any, site: Site) -> None:
    Bin(tmp_path).say(NOON_S)
    bridge, successor = Bridge(), Bin(tmp_path, NEXT)
    successor.say(NOON_S + 1)
    successor.say(NOON_S + DAY_S)
    poster(successor, bridge).post_due()
    assert {one.device for one in bridge.roots} == {BIN.address.lower(), NEXT.address.lower()}
    logs = [fetched(site, one, tmp_path / "fetched") for one in bridge.roots]
    assert {(one.log.address, one.log.first) for one in logs} == {
        (BIN.address.lower(), 1),
        (NEXT.address.lower(), 2),
    }
    assert {one.signer for one in logs} == {NEXT.address}, "the old key signs nothing any more"


def test_a_log_has_what_was_signed_that_day_and_nothing_else(tmp_path: Path) -> None:
    bin = Bin(tmp_path)
    first, second = bin.say(NOON_S), bin.say(NOON_S + 1)
    (one,) = bin.days.unposted()
    path = tmp_path / "log.json"
    path.write_text(bin.day_log(one).model_dump_json())
    logs = {20_000: SignedDay.load(path).log}
    assert not lacks(logs, 1, NOON_S, first)
    assert not lacks(logs, 2, NOON_S + 1, second)
    assert lacks(logs, 2, NOON_S + 1, first), "another statement under that number"
    assert lacks(logs, 3, NOON_S + 2, second), "one that was left out"
    assert not lacks(logs, 3, NOON_S + DAY_S, second), "of a day without a log"


def test_a_log_that_was_changed_is_none(tmp_path: Path) -> None:
    bin = Bin(tmp_path)
    bin.say(NOON_S)
    (one,) = bin.days.unposted()
    signed = bin.day_log(one).model_dump()
    signed["payload"]["statements"] = ["0x" + "ab" * 32]
    path = tmp_path / "log.json"
    path.write_text(json.dumps(signed))
    with pytest.raises(BadAttestation):
        SignedDay.load(path)
    path.write_text("{}")
    with pytest.raises(BadStatement):
        SignedDay.load(path)
