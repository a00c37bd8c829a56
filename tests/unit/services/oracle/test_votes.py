"""What an oracle makes of the votes of others, without a bus."""

from __future__ import annotations

import math
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest
from eth_abi import encode
from eth_account import Account
from eth_utils.abi import function_signature_to_4byte_selector

from rodeo.bus import queries
from rodeo.bus.messages import SealedVote, Vote
from rodeo.chain.node.translation import decode_revert
from rodeo.commands.judging import PostVotes
from rodeo.errors import RemoteError
from rodeo.host.clock import WallClock
from rodeo.judging import votes
from rodeo.money.currency import IEC
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.sections import JudgeConfig
from rodeo_testing import answers
from rodeo_testing.waiting import HANG_S
from services.oracle.voters import Voters
from services.oracle.votes import REPEAT_S, Votes
from tests.support.site import LAB
from tests.support.tasks import task

NAMES = ("anna", "bert", "carl", "dora", "erin")
KEYS = {name: Account.from_key("0x" + f"{number:02x}" * 32) for number, name in enumerate(NAMES, start=1)}
CHAIN = queries.Chain.model_validate(answers.chain())


def vote(**changes: Any) -> Vote:
    given = {
        "task_id": 1,
        "attempt": 1,
        **{f"{what}_sha256": "0x" + "3d" * 32 for what in ("proof", "report", "rules")},
        "ruling": "accepted",
        "amount_iec": "80",
        "reason": "accepted",
    }
    return Vote.model_validate(given | changes)


def signed(name: str, said: Vote | None = None) -> SealedVote:
    said = said or vote()
    signature = votes.sign(said, KEYS[name], CHAIN.chain_id, CHAIN.contracts.oracle_committee, IEC)
    return SealedVote(task_id=said.task_id, attempt=said.attempt, signature=signature)


def not_in_panel(key: str, place: int, panel: int) -> RemoteError:
    """The contract's error, as the bridge tells it."""
    selector = function_signature_to_4byte_selector("NotInPanel(uint256,address,uint256,uint256)")
    values = encode(["uint256", "address", "uint256", "uint256"], [1, key, place, panel])
    reverted = decode_revert(selector + values)
    return RemoteError(reverted.code, "refused", reverted.details)


def stake_too_low(seat: int) -> RemoteError:
    """The contract's error, as the bridge tells it."""
    selector = function_signature_to_4byte_selector("StakeTooLow(address,uint8,uint256,uint256)")
    values = encode(["address", "uint8", "uint256", "uint256"], [KEYS["anna"].address, seat, 0, 10**18])
    reverted = decode_revert(selector + values)
    return RemoteError(reverted.code, "refused", reverted.details)


class Moved(WallClock):
    """Wall time, later by what a test says."""

    by_s = 0.0

    def now_s(self) -> float:
        return super().now_s() + self.by_s


class Anna:
    """One of five oracles, of whom three have to agree, with bus and bridge in the test's hands."""

    def __init__(self) -> None:
        self.posted: list[PostVotes] = []
        self.refused: dict[str, str] = {}
        """Oracle whose vote the contract does not count -> the contract's error."""
        self.published: list[SealedVote] = []
        self.waits = True
        self.asked: list[str] = []
        self.needed = 3
        self.rotation_s = 600
        self.clock = Moved()
        self.submitted_s = float(int(self.clock.now_s()))
        self.is_indexed = True
        """Whether the oracle hears at once of the verdict that it has posted."""
        self.keys = {name: key.address for name, key in KEYS.items()}
        self.stakes = dict.fromkeys(NAMES, 5)
        wallet = SimpleNamespace(ask=self._ask, command=self._command)
        site = Site.load(LAB).model_copy(update={"oracles": [JudgeConfig(name=name) for name in NAMES]})
        bus = SimpleNamespace(
            put_json=lambda _key, one: self.published.append(one),
            subscribe_with_source=lambda _key, on_vote: SimpleNamespace(undeclare=lambda: None),
        )
        self.votes = Votes(
            site,
            "anna",
            Voters(site, KEYS["anna"], wallet),  # type: ignore[arg-type]
            bus,  # type: ignore[arg-type]
            wallet,  # type: ignore[arg-type]
            self.clock,
            lambda _task, _attempt: self.waits,
            lambda: None,
        )
        self.done = threading.Event()
        self._until = math.inf

    def hear(self, name: str, one: SealedVote, session: str = "") -> None:
        key = topics.VOTE.name(org="lab", judge=name)
        self.votes.on_vote(key, one.model_dump(mode="json"), session or name)

    def vote(self) -> None:
        window = {"proof_submitted": self.submitted_s, "case_end": self.submitted_s + 3600}
        self.votes.cast(task("submitted").model_copy(update=window), vote(), "anna.json")

    def held(self, how: str = "same") -> list[str]:
        return [name for one in self.votes.held() for name in one[how]]

    def later(self, by_s: float) -> None:
        """The time since the proof."""
        self.clock.by_s += self.submitted_s + by_s - self.clock.now_s()

    def run(self, until: int) -> None:
        """Let it work until it has posted so many times."""
        self._until = until
        self.done.clear()
        worker = threading.Thread(target=self.votes.run, args=(self.done,), daemon=True)
        worker.start()
        assert self.done.wait(HANG_S), self.posted
        worker.join(HANG_S)

    def _ask(self, query: queries.Query[Any]) -> Any:
        self.asked.append(query.what)
        if query is queries.CHAIN:
            return CHAIN
        return SimpleNamespace(
            judges=[
                SimpleNamespace(name=name, key=key, seat=seat, stake_iec=self.stakes[name])
                for seat, (name, key) in enumerate(self.keys.items())
            ],
            kinds=[
                SimpleNamespace(
                    kind="waste_disposal",
                    votes=self.needed,
                    panel=3,
                    rotation_s=self.rotation_s,
                    judge_stake_iec=5,
                )
            ],
        )

    def _command(self, name: str, request: PostVotes) -> None:
        assert name == "post_votes"
        self.posted.append(request)
        if len(self.posted) >= self._until:
            self.done.set()
        for judge, code in self.refused.items():
            if signed(judge).signature in request.signatures:
                if code == "not_in_panel":
                    raise not_in_panel(KEYS[judge].address, place=3, panel=3)
                if code == "stake_too_low":
                    raise stake_too_low(NAMES.index(judge))
                raise RemoteError(code, "refused", {"judge": KEYS[judge].address})
        self.waits = not self.is_indexed


@pytest.fixture
def anna() -> Anna:
    return Anna()


def test_votes_that_came_before_its_own_count_and_it_posts_what_it_completes(anna: Anna) -> None:
    anna.hear("bert", signed("bert"))
    anna.hear("carl", signed("carl"))
    assert anna.held() == []
    anna.vote()
    assert anna.published == [signed("anna")]
    anna.run(until=1)
    (request,) = anna.posted
    assert request.signatures == [signed(name).signature for name in ("anna", "bert", "carl")]
    assert request.report_uri == "anna.json"


def test_who_listens_learns_nothing_that_it_could_vote_for(anna: Anna) -> None:
    anna.vote()
    (published,) = anna.published
    assert published.model_dump(mode="json") == signed("anna").model_dump(mode="json")
    assert published.model_dump().keys() == {"task_id", "attempt", "signature"}
    # All that a judge who has made no report can do: hand on what it heard, or guess the report.
    anna.hear("bert", published)
    anna.hear("carl", signed("carl", vote(report_sha256="0x" + "00" * 32)))
    assert (anna.held(), anna.held("other")) == (["anna"], ["bert", "carl"])
    assert anna.votes.due() == []


def test_a_false_vote_in_a_judges_name_displaces_none_of_its_own(anna: Anna) -> None:
    anna.hear("bert", signed("bert"))
    anna.hear("bert", signed("erin"))
    anna.vote()
    anna.hear("bert", signed("dora"))
    assert (anna.held(), anna.held("other")) == (["anna", "bert"], [])


def test_of_those_who_vote_early_as_much_is_kept_whatever_strangers_publish(anna: Anna) -> None:
    for number in range(50):
        anna.hear("bert", signed("erin", vote(reason=str(number))))
    assert [len(kept) for kept in anna.votes.early.values()] == [4]
    anna.hear("bert", signed("bert"))  # it is published again and again
    anna.vote()
    assert anna.held() == ["anna", "bert"]


def test_a_flood_of_false_votes_is_checked_in_part_and_silences_nobody_who_was_heard(
    anna: Anna, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks = 0
    signer = votes.signer

    def counted(*given: Any) -> str | None:
        nonlocal checks
        checks += 1
        return signer(*given)

    monkeypatch.setattr(votes, "signer", counted)
    for task_id in (1, 2):
        window = {"id": task_id, "proof_submitted": anna.submitted_s}
        anna.votes.cast(
            task("submitted").model_copy(update=window | {"case_end": anna.submitted_s + 3600}),
            vote(task_id=task_id),
            "anna.json",
        )
    anna.hear("bert", signed("bert"))
    false = [signed("carl", vote(task_id=2, reason=f"no {number}")) for number in range(400)]
    for one in false:
        anna.hear("bert", one, "another session")
    anna.hear("bert", signed("bert", vote(task_id=2)))
    assert [one["same"] for one in anna.votes.held()] == [["anna", "bert"]] * 2
    assert checks < len(false)


def test_a_vote_that_another_key_signed_is_nobodys(anna: Anna) -> None:
    anna.vote()
    anna.hear("bert", signed("erin"))
    anna.hear("nobody", signed("erin"))
    assert anna.held() == ["anna"]


def test_the_bridge_is_asked_once_whatever_strangers_publish(
    anna: Anna, monkeypatch: pytest.MonkeyPatch
) -> None:
    anna.vote()
    for _ in range(20):
        anna.hear("bert", signed("erin"))
    assert sorted(anna.asked) == ["chain", "organization"]
    # Who votes with another key from now on is known a little later.
    monkeypatch.setitem(anna.keys, "bert", KEYS["erin"].address)
    later_s = time.monotonic() + REPEAT_S
    monkeypatch.setattr("services.oracle.votes.time.monotonic", lambda: later_s)
    anna.hear("bert", signed("erin"))
    anna.hear("bert", signed("bert"))
    assert anna.held() == ["anna", "bert"] and len(anna.asked) == 4


def test_a_quorum_that_changes_counts_for_votes_that_are_held(
    anna: Anna, monkeypatch: pytest.MonkeyPatch
) -> None:
    anna.needed = 4
    anna.hear("bert", signed("bert"))
    anna.hear("carl", signed("carl"))
    anna.vote()
    assert [one["needed"] for one in anna.votes.held()] == [4] and anna.votes.due() == []
    anna.needed = 3
    later_s = time.monotonic() + REPEAT_S
    monkeypatch.setattr("services.oracle.votes.time.monotonic", lambda: later_s)
    anna.votes.repeat()
    assert anna.votes.pause_s() < 1.0  # something is due soon


def test_votes_for_something_else_do_not_make_a_verdict(anna: Anna) -> None:
    anna.vote()
    anna.hear("bert", signed("bert"))
    anna.hear("carl", signed("carl", vote(report_sha256="0x" + "11" * 32)))
    anna.hear("erin", signed("erin", vote(ruling="rejected", amount_iec="0")))
    assert (anna.held(), anna.held("other")) == (["anna", "bert"], ["carl", "erin"])
    assert anna.votes.due() == [] and anna.votes.pause_s() == 1.0


def test_what_the_contract_does_not_count_is_left_out(anna: Anna) -> None:
    anna.refused["bert"] = "judge_is_party"
    for name in ("bert", "carl", "dora"):
        anna.hear(name, signed(name))
    anna.vote()
    anna.run(until=2)
    assert [len(one.signatures) for one in anna.posted] == [3, 3]
    assert anna.posted[1].signatures == [signed(name).signature for name in ("anna", "carl", "dora")]


def test_a_vote_whose_judge_has_another_key_by_now_holds_up_no_other(
    anna: Anna, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The contract's error names the key that signed, which is nobody's any more."""
    anna.refused["bert"] = "not_a_judge"
    for name in ("bert", "carl", "dora"):
        anna.hear(name, signed(name))
    anna.vote()
    monkeypatch.setitem(anna.keys, "bert", Account.from_key("0x" + "77" * 32).address)
    anna.votes.voters.ask()
    anna.run(until=2)
    assert anna.posted[1].signatures == [signed(name).signature for name in ("anna", "carl", "dora")]


@pytest.mark.parametrize("without", ["anna", "bert"])
def test_the_vote_of_a_judge_whose_stake_is_too_low_is_not_posted(anna: Anna, without: str) -> None:
    anna.stakes[without] = 4
    for name in ("bert", "carl", "dora"):
        anna.hear(name, signed(name))
    anna.vote()
    if without == "anna":  # hers is not the last that was needed
        anna.hear("erin", signed("erin"))
    anna.run(until=1)
    counted = [name for name in ("anna", "bert", "carl", "dora") if name != without]
    assert anna.posted[0].signatures == [signed(name).signature for name in counted]


def test_a_stake_that_was_lost_a_moment_ago_holds_nobody_up(anna: Anna) -> None:
    anna.refused["bert"] = "stake_too_low"
    for name in ("bert", "carl", "dora"):
        anna.hear(name, signed(name))
    anna.vote()
    anna.run(until=2)
    assert anna.posted[1].signatures == [signed(name).signature for name in ("anna", "carl", "dora")]


def test_a_vote_counts_once_somebody_has_added_to_its_judges_stake(
    anna: Anna, monkeypatch: pytest.MonkeyPatch
) -> None:
    anna.stakes["bert"] = 0
    for name in ("bert", "carl"):
        anna.hear(name, signed(name))
    anna.vote()
    assert anna.votes.due() == [] and anna.votes.pause_s() == 1.0
    anna.stakes["bert"] = 5
    later_s = time.monotonic() + REPEAT_S
    monkeypatch.setattr("services.oracle.votes.time.monotonic", lambda: later_s)
    anna.votes.voters.current()  # as for the vote of a stranger
    anna.votes.repeat()
    assert anna.votes.pause_s() < 1.0  # something is due soon


def test_votes_whose_judges_stake_stands_for_other_cases_are_tried_again_when_those_may_have_ended(
    anna: Anna,
) -> None:
    anna.refused["bert"] = "stake_too_low"
    for name in ("bert", "carl"):
        anna.hear(name, signed(name))
    anna.vote()
    anna.run(until=1)
    assert anna.votes.due() == []
    anna.later(59)
    assert anna.votes.due() == []
    anna.later(60)
    anna.refused.clear()
    anna.run(until=2)
    assert anna.posted[1].signatures == [signed(name).signature for name in ("anna", "bert", "carl")]


def test_nothing_is_kept_of_what_has_its_verdict(anna: Anna) -> None:
    anna.vote()
    anna.waits = False
    anna.hear("bert", signed("bert"))
    anna.votes.forget()
    assert anna.votes.keys() == set() and anna.held() == []


def three_votes_of_which_one_is_early(anna: Anna) -> None:
    """Bert is not in the panel for another 600 s, and the contract has said so."""
    anna.refused["bert"] = "not_in_panel"
    for name in ("bert", "carl"):
        anna.hear(name, signed(name))
    anna.vote()
    anna.run(until=1)
    assert anna.votes.due() == []


def test_a_vote_that_came_too_early_is_posted_when_its_judge_is_in_the_panel(anna: Anna) -> None:
    three_votes_of_which_one_is_early(anna)
    anna.later(599)
    assert anna.votes.due() == [] and anna.votes.pause_s() == 1.0
    anna.later(600)
    anna.refused.clear()
    anna.run(until=2)
    assert anna.posted[1].signatures == [signed(name).signature for name in ("anna", "bert", "carl")]
    assert anna.posted[1].request_id != anna.posted[0].request_id  # the bridge repeats no refusal


def test_a_panel_that_has_not_grown_as_said_is_asked_again_without_haste(anna: Anna) -> None:
    three_votes_of_which_one_is_early(anna)
    anna.later(600)
    anna.votes.post((1, 1))
    assert len(anna.posted) == 2 and anna.votes.due() == []
    assert anna.votes.pause_s() > 0.5


def test_votes_are_not_posted_after_the_window(anna: Anna) -> None:
    three_votes_of_which_one_is_early(anna)
    anna.later(3600.5)
    assert anna.votes.due() == []


@pytest.mark.parametrize("rotation_s", [0, 3601])
def test_a_judge_who_is_never_in_the_panel_in_time_is_not_waited_for(anna: Anna, rotation_s: int) -> None:
    anna.rotation_s = rotation_s
    three_votes_of_which_one_is_early(anna)
    anna.later(3599)
    assert anna.votes.due() == [] and anna.votes.next_panel_s() is None


def test_who_waits_for_the_panel_does_not_wait_for_it_once_others_in_it_agree(anna: Anna) -> None:
    three_votes_of_which_one_is_early(anna)
    anna.hear("dora", signed("dora"))
    anna.run(until=3)
    assert anna.posted[-1].signatures == [signed(name).signature for name in ("anna", "carl", "dora")]


def test_votes_are_posted_once_however_late_the_oracle_hears_of_it(anna: Anna) -> None:
    anna.is_indexed = False
    for name in ("bert", "carl"):
        anna.hear(name, signed(name))
    anna.vote()
    anna.votes.post((1, 1))
    anna.hear("dora", signed("dora"))
    assert anna.waits and len(anna.posted) == 1
    assert anna.votes.due() == [] and anna.votes.pause_s() == 1.0


def test_votes_that_may_still_be_mined_are_not_sent_a_second_time(anna: Anna) -> None:
    anna.refused["bert"] = "transaction_timeout"
    for name in ("bert", "carl"):
        anna.hear(name, signed(name))
    anna.vote()
    for _ in range(2):
        anna.votes.post((1, 1))
    assert anna.posted[0] == anna.posted[1]  # the bridge answers the same request without sending it
