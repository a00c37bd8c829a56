"""Several oracles that have to agree: three votes of five, over the bus, with real processes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account
from typer.testing import CliRunner

from rodeo.bus.messages import SealedVote, Task, Vote
from rodeo.errors import RemoteError
from rodeo.judging import votes
from rodeo.money.currency import IEC
from rodeo.signing import keystores, wallets
from rodeo.site import topics
from rodeo_cli import app
from rodeo_testing.waiting import wait_until
from tests.support.dao import Dao, founded
from tests.support.executor import Executor, Film, stored
from tests.support.site import NewSite

pytestmark = pytest.mark.long

ORACLES = ("anna", "bert", "carl", "dora", "erin")
AT_WORK = ("oracle.anna", "oracle.bert", "oracle.carl")
"""Dora's machine is off, and erin lies."""
SITE = "".join(f'\n[[oracles]]\nname = "{name}"\n' for name in ORACLES)


@pytest.fixture(scope="module")
def dao(new_site: NewSite) -> Iterator[Dao]:
    with founded(new_site(SITE), *AT_WORK) as organization:
        organization.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
        yield organization


def lie(dao: Dao, task: Task, signed_by: str, name: str) -> None:
    """Publish, in the name of the oracle `name`, that the proof is no good."""
    chain = dao.state("chain")
    vote = Vote(
        task_id=task.id,
        attempt=task.attempt,
        proof_sha256=task.proof_sha256 or "",
        report_sha256="0x" + "11" * 32,
        rules_sha256=task.rules_sha256 or "",
        ruling="rejected",
        reason="I was paid for saying this",
    )
    key = wallets.load(dao.site, f"{signed_by}-device")
    signature = votes.sign(vote, key, chain["chain_id"], chain["contracts"]["OracleCommittee"], IEC)
    sealed = SealedVote(task_id=task.id, attempt=task.attempt, signature=signature)
    dao.running.bus.put_json(topics.VOTE.name(org=dao.site.org, judge=name), sealed)


def test_three_of_five_pay_honest_work_while_one_lies_and_one_is_off(dao: Dao, tmp_path: Path) -> None:
    executor = Executor(dao, Film(dao), tmp_path)
    task_id = executor.assigned()
    dao.running.kill("oracle.carl")
    attempt = executor.submit(task_id, *stored(executor, task_id))
    task = executor.wallet.task(task_id)

    def is_heard() -> bool:
        """Published again and again, as votes are: who has not heard of the submission yet ignores them."""
        lie(dao, task, "erin", "erin")
        lie(dao, task, "erin", "carl")  # a false name, too
        said = "carl votes otherwise, or somebody publishes in its name"
        return said in dao.running.log("oracle.anna", 100_000)

    wait_until(is_heard)
    for name in ("oracle.anna", "oracle.bert"):
        status = dao.running.wait_for_status(
            name, lambda one: any(held["same"] == ["anna", "bert"] for held in one.details.get("votes", []))
        )
        (held,) = status.details["votes"]
        assert (held["task_id"], held["attempt"], held["needed"]) == (task_id, attempt, 3)
        assert set(held["other"]) <= {"carl", "erin"}
    assert "Ruled" not in dao.names_of(task_id)

    with pytest.raises(RemoteError) as refused:  # alone, none of them is a judge
        dao.verdict(task_id, "accepted", judge="anna", amount_iec="100")
    assert refused.value.code == "not_a_judge"

    dao.running.start("oracle.carl")  # it completes the votes
    verdict = executor.verdict(task_id, attempt)
    assert (verdict["verdict"], verdict["reason"]) == ("accepted", "accepted")
    dao.wait_for(
        lambda: "VotesCounted" in dao.names_of(task_id), "the count, which is logged after the payment"
    )
    (counted,) = [one for one in dao.events if one.name == "VotesCounted" and one.task_id == task_id]
    assert counted.args["seats"] == 0b00111
    assert counted.args["rules"] == task.rules_sha256
    dao.running.wait_for_status("oracle.anna", lambda one: not one.details.get("votes"))


def test_a_judges_key_changes_in_one_call(dao: Dao) -> None:
    before = dao.state("organization")
    (cleaning,) = [one for one in before["kinds"] if one["kind"] == "waste_disposal"]
    assert (cleaning["votes"], cleaning["panel"], cleaning["seats"]) == (3, 5, [0, 1, 2, 3, 4])
    assert [one["name"] for one in before["judges"]] == list(ORACLES)
    key = keystores.address(dao.site, "panther1-device")
    env = {"RODEO_SITE": str(dao.running.path)}
    asked = ["organization", "sign-seat", "panther1-device", "--owner", keystores.address(dao.site, "dora")]
    signed = CliRunner().invoke(app, asked, env=env)
    assert signed.exit_code == 0, signed.output
    change = ["organization", "judge-key", "dora", key, "--signature", signed.output.strip()]
    shown = CliRunner().invoke(app, change, env=env)
    assert shown.exit_code == 0, shown.output
    after = dao.state("organization")["judges"]
    assert [one["name"] for one in after] == list(ORACLES)
    assert [one["key"] for one in after] == [
        key if one["name"] == "dora" else one["key"] for one in before["judges"]
    ]
    told = CliRunner().invoke(app, ["organization", "show"], env={"RODEO_SITE": str(dao.running.path)}).output
    assert "3 of 5 oracles that agree" in told and key in told


def test_judges_are_seated_and_unseated_and_the_quorum_follows(dao: Dao) -> None:
    def rodeo(*arguments: str, status: int = 0) -> str:
        done = CliRunner().invoke(
            app, ["organization", *arguments], env={"RODEO_SITE": str(dao.running.path), "COLUMNS": "300"}
        )
        assert done.exit_code == status, done.output
        return done.output

    def quorum() -> dict[str, Any]:
        (kind,) = [one for one in dao.state("organization")["kinds"] if one["kind"] == "waste_disposal"]
        return {name: kind[name] for name in ("votes", "panel", "rotation_s", "seats")}

    def judges(*named: str) -> list[str]:
        return [part for one in named for part in ("--judge", one)]

    account = Account.create()
    fay, sits = account.address, ("--signature", dao.possession(account, "panther1"))
    rodeo("quorum", "waste_disposal", "3", "--panel", "5", "--rotation", "0", *judges(*ORACLES))
    rodeo("seat", fay, "--owner", "panther1", *sits)
    assert "already_seated" in rodeo("seat", fay, "--owner", "panther1", *sits, status=1)
    other = Account.create().address
    assert "key_not_proven" in rodeo("seat", other, "--owner", "panther1", *sits, status=1)
    (seated,) = [one for one in dao.state("organization")["judges"] if one["key"] == fay]
    seat = seated["seat"]
    assert seat >= 5 and seated["owner_name"] == "panther1"
    assert f"{fay}, judges nothing" in rodeo("show")
    unchanged = {"votes": 3, "panel": 5, "rotation_s": 0, "seats": [0, 1, 2, 3, 4]}
    assert quorum() == unchanged
    assert "not_a_judge" in rodeo("unseat", fay, status=1)
    assert "unknown_participant" in rodeo("unseat", "nobody", status=1)
    assert "unknown_participant" in rodeo("unseat", "0x" + "ab" * 20, status=1)
    assert "unknown_kind" in rodeo("quorum", "sweeping", "1", "--judge", "anna", status=1)

    # Not dora, who may have the key of panther1's device by now: two of one owner are no two judges.
    rodeo("quorum", "waste_disposal", "3", *judges("anna", "bert", "carl", ORACLES[4], fay))
    assert quorum() == unchanged | {"seats": [0, 1, 2, 4, seat]}
    rodeo("quorum", "waste_disposal", "2", "--panel", "3", "--rotation", "60")
    assert quorum() == {"votes": 2, "panel": 3, "rotation_s": 60, "seats": [0, 1, 2, 4, seat]}
    refused = rodeo("quorum", "waste_disposal", "2", "--panel", "4", status=1)
    assert "invalid_quorum" in refused and "panel: 4" in refused and "judges: 5" in refused
    rodeo("unseat", fay)
    assert f"{fay}, judges nothing" in rodeo("show")
    rodeo("quorum", "waste_disposal", "2", *judges("anna", "bert", "carl"))
    assert quorum() == {"votes": 2, "panel": 3, "rotation_s": 60, "seats": [0, 1, 2]}
    rodeo("quorum", "waste_disposal", "3")
    assert "invalid_quorum" in rodeo("unseat", "carl", status=1)
