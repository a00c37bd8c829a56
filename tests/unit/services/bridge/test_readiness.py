"""When an index does not count as current, and what a bridge does as time passes."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.chain.node.errors import ContractReverted, RpcFailed
from rodeo.judging.rulings import GRACE_S
from rodeo.runtime.state import Notices
from rodeo.site.config import Site
from services.bridge.ends import End, Ends, late_verdicts, many_voids, own_rulings, send_end
from services.bridge.index import Position
from services.bridge.readiness import Probe, why_late
from tests.support.site import write_site
from tests.support.tasks import UNTIL_S, ruled


@pytest.mark.parametrize(
    ("max_block_age_s", "now_s", "late"), [(None, 10**10, False), (60.0, 1060.0, False), (60.0, 1061.0, True)]
)
def test_a_node_whose_newest_block_is_old_is_behind(
    max_block_age_s: float | None, now_s: float, late: bool
) -> None:
    why = why_late(Position(7, "0x", 1000), max_block_age_s, now_s)
    assert (why is not None) == late
    assert why is None or "older than 60 s" in why


@pytest.mark.parametrize(("elsewhere", "told"), [(True, True), (False, False)])
def test_a_machine_whose_clock_is_behind_a_chain_elsewhere_says_so(elsewhere: bool, told: bool) -> None:
    """A local chain has the site's own time, which may be any."""
    why = why_late(Position(7, "0x", 1007), None, 1000.0, elsewhere)
    assert why == ("clock 7 s behind the chain's newest block" if told else None)


def test_a_bridge_concludes_the_rulings_that_pay_executors_whose_keys_it_has() -> None:
    tasks = ruled(1, executor="0x01"), ruled(2, executor="0x02"), ruled(3, "rejected", executor="0x01")
    rows, due_s = [one.model_dump() for one in tasks], UNTIL_S + GRACE_S
    assert own_rulings(rows, {"0x01": "alice"}, UNTIL_S + 1) == ([], due_s)
    assert own_rulings(rows, {"0x01": "alice"}, due_s + 1) == ([End("alice", "conclude", 1)], None)
    assert own_rulings(rows, {"0x03": "carol"}, due_s + 1) == ([], None)


class AtOnce:
    """Does what it is given before it returns."""

    def submit(self, act: Callable[..., Any], *given: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(act(*given))
        return done


@pytest.mark.parametrize("mined", [True, False])
def test_a_bridge_without_the_organizations_key_ends_no_window_but_those_rulings(
    mined: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever has taken the organization's bridge down takes nobody's pay by that. What is not mined yet is
    not sent again."""
    monkeypatch.setattr("services.bridge.ends._EXPIRY_RETRY_S", 60.0 if mined else 0.0)
    site = Site.load(write_site(tmp_path, extra='[[bridges]]\nname = "own"\nwallets = ["panther1"]\n'))
    clock = SimpleNamespace(now_s=lambda: UNTIL_S + GRACE_S + 1)
    told: Any = SimpleNamespace(site=site, name="bridge.own", stop=threading.Event(), clock=clock)
    told.notices = notices = Notices()
    accounts: Any = {"panther1": SimpleNamespace(address="0x01")}
    threads: Any = {"panther1": AtOnce()}
    ends = Ends(told, lambda: None, lambda: accounts, threads)
    sent: list[Any] = []

    def execute(*command: Any) -> Future[Any]:
        sent.append(command)
        reply: Future[Any] = Future()
        if mined:
            reply.set_result({})
        return reply

    rows = [ruled(7, executor="0x01").model_dump(), ruled(8, executor="0x02").model_dump()]
    tasks = SimpleNamespace(
        unconcluded=lambda: rows,
        late_verdicts=lambda _now_s: [7],
        recent_voids=lambda _last: {None: (9, {"oracle": 1})},
        in_state=lambda _state: [],
    )
    services = SimpleNamespace(providers=dict, engaged=set, idle=list, locked_bonds=list)
    index = SimpleNamespace(tasks=tasks, services=services)
    wallets = {"panther1": SimpleNamespace(execute=execute)}
    handback = SimpleNamespace(can_do=lambda _name, _kind: True)
    attachment: Any = SimpleNamespace(chain=SimpleNamespace(index=index), wallets=wallets, handback=handback)
    assert [ends.expire_overdue(attachment), ends.expire_overdue(attachment)] == [None, None]
    assert sent == [("conclude", {"task_id": 7})]
    verdicts, voids = notices.texts()
    assert "task 7" in verdicts
    assert "1 of the last 9 rulings on tasks of this site are void" in voids


@pytest.mark.parametrize("code", ["WrongState", "RulingStands", "NoCase", "NotAuthorized"])
def test_whoever_concludes_a_ruling_after_somebody_else_warns_nobody(
    code: str, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_command: Any) -> Future[Any]:
        raise ContractReverted(code, {})

    wallet: Any = SimpleNamespace(execute=refuse)
    assert send_end(wallet, End("organization", "settle_stakes", 7, 2)) is None
    assert bool(caplog.records) == (code == "NotAuthorized")


def test_a_node_that_went_back_to_a_shorter_chain_answers_well() -> None:
    """Anvil, geth and others refuse logs of a block that they do not have."""
    head, chain_id = 9, 31337

    def answer(method: str, params: list[Any]) -> Any:
        if method == "eth_getLogs":
            named = [params[0][bound] for bound in ("fromBlock", "toBlock")]
            beyond = any(one.startswith("0x") and int(one, 16) > head for one in named)
            return RpcFailed("block height is 9", rpc_code=-32602) if beyond else []
        answers = {"eth_chainId": hex(chain_id), "eth_getBlockByNumber": {}, "eth_call": "0x" + "0" * 64}
        return answers.get(method, "0x0")

    chain: Any = SimpleNamespace(
        ask=lambda *calls: [answer(*one) for one in calls],
        node=SimpleNamespace(bad=0),
        index=SimpleNamespace(position=Position(head + 1, "0x", 1000), newest_transaction=lambda: None),
        deployment=SimpleNamespace(chain_id=chain_id, address=lambda _: "0x01", event_sources=["0x01"]),
    )
    probe = Probe(chain, {}, SimpleNamespace(can_send=lambda: True))  # type: ignore[arg-type]
    assert probe.problem() is None


def test_tasks_without_a_verdict_at_half_of_the_window_are_named() -> None:
    assert late_verdicts([]) == ""
    assert "without a ruling on task 7:" in late_verdicts([7])
    assert "on tasks 1, 2, 3, 4, 5 and 2 more:" in late_verdicts(range(1, 8))


def test_a_void_share_above_a_twentieth_is_told_of_the_site_and_of_each_creator() -> None:
    assert many_voids({}, {}.get) == ""
    assert many_voids({None: (100, {"oracle": 5}), "0x01": (100, {"creators_witness": 5})}, {}.get) == ""
    told = many_voids(
        {
            None: (100, {"oracle": 4, "creators_witness": 2}),
            "0x01": (20, {"creators_witness": 2, "oracle": 4}),
        },
        {"0x01": "alice"}.get,
    )
    assert told == (
        "6 of the last 100 rulings on tasks of this site are void: 2 the doing of a device that the creator "
        "owns, 4 the judge's doing; 2 of the last 20 rulings on tasks of the creator alice are void: "
        "2 the doing of a device that the creator owns"
    )


@pytest.mark.parametrize("fault", ["oracle", "other_witness", "nobody"])
def test_what_was_not_its_doing_does_not_count_against_a_creator(fault: str) -> None:
    assert many_voids({"0x01": (10, {fault: 10})}, {}.get) == ""
