"""One process at a time serves a wallet or a device, with real sessions on a real router."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
import zenoh

from rodeo.errors import Interrupted, ServedElsewhere
from rodeo.runtime.serving import Claim, Holder, Rival, Thing, served_by
from rodeo.site.config import Site
from rodeo.site.sections import OtherBridgeConfig, RosConfig
from rodeo_testing.waiting import HANG_S
from tests.support.site import LAB

PANTHER1, PANTHER2 = Thing("wallet", "panther1"), Thing("wallet", "panther2")
NEVER = threading.Event()


def claim(session: zenoh.Session, since: int, *things: Thing) -> Claim:
    holder = Holder(since, 100 + since, f"host{since}")
    return Claim(session, "lab", things or [PANTHER1], lambda: True, holder)


def test_a_second_one_is_refused_and_told_who_serves(connect: Callable[[], zenoh.Session]) -> None:
    first, second = claim(connect(), 2), claim(connect(), 1)
    first.take(NEVER)
    said: list[str] = []
    # Not even an elder: the time of a machine may be wrong.
    with pytest.raises(ServedElsewhere, match="already served by process 102 on host2: wallet panther1"):
        second.take(NEVER, said.append, lease_s=0.5)
    assert said and "waiting up to" in said[0]


def test_whoever_serves_hears_of_one_that_was_refused(connect: Callable[[], zenoh.Session]) -> None:
    first, second = claim(connect(), 1), claim(connect(), 2)
    rivals: list[Rival] = []
    heard = threading.Event()

    def on_rival(rival: Rival) -> None:
        rivals.append(rival)
        heard.set()

    first.take(NEVER)
    first.watch(on_rival, lambda error: pytest.fail(str(error)))
    with pytest.raises(ServedElsewhere):
        second.take(NEVER, lambda _: None, lease_s=0.3)
    assert heard.wait(HANG_S)
    assert (rivals[0].thing, str(rivals[0].holder)) == (PANTHER1, "process 102 on host2")


def test_others_serve_what_is_theirs(connect: Callable[[], zenoh.Session]) -> None:
    first, second = claim(connect(), 1, PANTHER1), claim(connect(), 2, PANTHER2)
    first.take(NEVER)
    second.take(NEVER, lease_s=0.0)


@pytest.mark.parametrize("end", ["closed", "killed"])
def test_what_a_wait_cures_is_waited_for(connect: Callable[[], zenoh.Session], end: str) -> None:
    session = connect()
    first, second = claim(session, 1), claim(connect(), 2)
    first.take(NEVER)
    threading.Timer(0.5, first.close if end == "closed" else session.close).start()
    second.take(NEVER, lambda _: None, lease_s=HANG_S)


def test_of_many_that_start_at_once_one_serves(connect: Callable[[], zenoh.Session]) -> None:
    things = [[PANTHER1], [PANTHER1, PANTHER2], [PANTHER2, PANTHER1], [PANTHER1]]
    claims = [claim(connect(), since, *some) for since, some in enumerate(things)]
    together = threading.Barrier(len(claims))
    served: list[Claim] = []
    refused: list[ServedElsewhere] = []

    def take(one: Claim) -> None:
        together.wait()
        try:
            one.take(NEVER, lambda _: None, lease_s=2.0)
            served.append(one)
        except ServedElsewhere as error:
            refused.append(error)

    threads = [threading.Thread(target=take, args=(one,)) for one in claims]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(served), len(refused)) == (1, 3)


def test_after_a_partition_the_younger_of_two_ends(connect: Callable[[], zenoh.Session]) -> None:
    elder, younger = claim(connect(), 1), claim(connect(), 2)
    lost: list[ServedElsewhere] = []
    ended = threading.Event()

    def on_lost(error: ServedElsewhere) -> None:
        lost.append(error)
        ended.set()

    younger.take(NEVER)
    younger.watch(lambda _: None, on_lost)
    # The elder was on the other side: what it serves comes with the connection.
    elder._serves = elder._declare("serves")
    elder.watch(lambda _: None, lambda error: pytest.fail(str(error)))
    assert ended.wait(HANG_S)
    assert "process 101 on host1" in str(lost[0])


def test_who_is_asked_to_stop_does_not_wait(connect: Callable[[], zenoh.Session]) -> None:
    first = claim(connect(), 1)
    first.take(NEVER)
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    with pytest.raises(Interrupted):
        claim(connect(), 2).take(stop, lambda _: None, lease_s=HANG_S)


def test_without_a_router_nothing_is_served(connect: Callable[[], zenoh.Session]) -> None:
    stop = threading.Event()
    said: list[str] = []
    lonely = Claim(connect(), "lab", [PANTHER1], lambda: False)
    threading.Timer(0.5, stop.set).start()
    with pytest.raises(Interrupted):
        lonely.take(stop, said.append)
    assert "router" in said[0]


def test_each_process_serves_what_it_has_the_key_or_the_name_of() -> None:
    site = Site.load(LAB)
    assert served_by(site, "robot_agent") == [Thing("robot", "panther1")]
    assert served_by(site, "itrash") == [Thing("bin", "itrash")]
    assert served_by(site, "charger") == [Thing("dock", "dock1")]
    assert [one.name for one in served_by(site, "bridge")] == ["organization", "panther1", "oracle"]
    assert served_by(site, "router") == []
    apart = site.model_copy(update={"bridges": [OtherBridgeConfig(name="judges")]})
    assert [one.name for one in served_by(apart, "bridge")] == ["organization", "panther1"]
    assert served_by(apart, "bridge.judges") == [Thing("wallet", "oracle")]
    plural = Site.load(LAB.with_name("plural.toml"))
    assert served_by(plural, "itrash.bin_east") == [Thing("bin", "bin_east")]
    assert served_by(plural, "charger.dock_west") == [Thing("dock", "dock_west")]
    ros = RosConfig(owner="annas", participants=["anna"])
    assert served_by(site.model_copy(update={"ros": [ros]}), "ros_dao") == [Thing("ros", "annas")]
