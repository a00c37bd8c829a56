"""People's work from the terminal: handed in, compared with all others, judged by an auditor alone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from rodeo.person.photo_code import photo_code
from rodeo_cli import app
from tests.support.dao import Dao
from tests.support.site import NewSite, RunningSite
from tests.unit.vision.test_likeness import jpeg, scene

pytestmark = pytest.mark.long

SITE = """clock.source = "wall"
clock.speed = 1
clock.idle_speed = 1
participants = [{ name = "alice" }, { name = "bob" }]
"""


@pytest.fixture(scope="module")
def dao(new_site: NewSite) -> Iterator[Dao]:
    with RunningSite(new_site(SITE)) as running:
        running.start_founded("bridge", "oracle")
        dao = Dao(running)
        for name in ("alice", "bob"):  # so that they work with several services at once
            rodeo(dao, "organization", "vouch", name)
        yield dao


def rodeo(dao: Dao, *arguments: str, status: int = 0) -> str:
    done = CliRunner().invoke(app, [*arguments, "--site", str(dao.running.path)])
    assert done.exit_code == status, done.output
    return " ".join(str(done.output).split())


def test_an_offer_is_priced_paused_resumed_and_withdrawn_and_made_once(dao: Dao) -> None:
    told = rodeo(dao, "organization", "kind", "raking", status=1)
    assert "choose who judges raking: --judge auditor for people, or --judge oracle" in told
    rodeo(dao, "organization", "kind", "raking", "--judge", "auditor")
    told = rodeo(dao, "service", "offer", "raking", "--price", "5", "--as", "alice")
    number = told.split()[-1].rstrip(".")

    def now() -> tuple[str, str]:
        (service,) = dao.state("services", provider="alice", kind="raking")["services"]
        return service["state"], service["price_iec"]

    told = rodeo(dao, "service", "offer", "raking", "--price", "6", "--as", "alice", status=1)
    assert f"alice offers raking already, as service {number}, which is active" in told
    rodeo(dao, "service", "price", number, "7.5")
    assert now() == ("active", "7.5")
    rodeo(dao, "service", "pause", number, "--as", "alice")
    assert now() == ("paused", "7.5")
    rodeo(dao, "service", "resume", number)
    assert now() == ("active", "7.5")
    told = rodeo(dao, "service", "withdraw", number, "--as", "bob", status=1)
    assert "only the service's provider may change it" in told and "caller: bob, provider: alice" in told
    told = rodeo(dao, "service", "pause", number, "--as", "bob", status=1)
    assert f"service {number} belongs to another participant than bob" in told
    assert now() == ("active", "7.5")
    rodeo(dao, "service", "withdraw", number)
    assert now() == ("retired", "7.5")
    assert "there is no service 999" in rodeo(dao, "service", "pause", "999", status=1)


@pytest.mark.parametrize(("who", "kind"), [("panther1", "raking"), ("alice", "waste_disposal")])
def test_nobody_offers_from_the_terminal_what_they_cannot_do(dao: Dao, who: str, kind: str) -> None:
    rodeo(dao, "organization", "kind", "raking", "--judge", "auditor")
    told = rodeo(dao, "service", "offer", kind, "--price", "5", "--as", who, status=1)
    assert f"{who} cannot do {kind}" in told
    assert dao.state("services", provider=who, kind=kind)["services"] == []


def handed_in(dao: Dao, kind: str, who: str, note: str, photo: Path) -> int:
    """A task of this kind, done by the only one who offers it now; its id."""
    rodeo(dao, "service", "offer", kind, "--price", "5", "--as", who)
    task_id = dao.post("6", kind=kind, params={}, max_attempts=1)
    code = photo_code(dao.task(task_id)["nonce"])
    assert code in rodeo(dao, "task", "accept", str(task_id), "--as", who)
    assert code in rodeo(dao, "task", "show", str(task_id))
    rodeo(dao, "task", "submit", str(task_id), "--as", who, "--note", note, "--photo", str(photo))
    return task_id


def test_a_copied_photo_and_note_are_shown_with_what_they_copy_and_the_auditor_decides(
    dao: Dao, tmp_path: Path
) -> None:
    for kind in ("wheel_cleaning", "dusting"):
        rodeo(dao, "organization", "kind", kind, "--judge", "auditor")
    own, copied = tmp_path / "own.jpg", tmp_path / "copied.jpg"
    cv2.imwrite(str(own), scene(1))
    cv2.imwrite(str(copied), jpeg(scene(1)[8:], 40))
    first = handed_in(dao, "wheel_cleaning", "alice", "Clean again.", own)
    second = handed_in(dao, "dusting", "bob", "clean  again.", copied)

    told = rodeo(dao, "task", "review", str(second))
    assert f"Photo 1 looks like photo 1 of task {first} attempt 1, handed in by alice" in told
    assert f"The note has the words of task {first} attempt 1, handed in by alice" in told
    assert f"Photo 1 looks like photo 1 of task {second} attempt 1, handed in by bob" in rodeo(
        dao, "task", "review", str(first)
    )
    rodeo(dao, "task", "judge", str(second), "--reject", "--reason", "Alice's photo")
    told = rodeo(dao, "task", "judge", str(first), "--accept", "--reason", "One can see it")
    word = "accepted by the auditor organization (a person): “One can see it”"
    assert word in told
    shown = rodeo(dao, "task", "show", str(first))
    assert word in shown and "oracle" not in shown
    sha256 = dao.task(first)["proof_sha256"].removeprefix("0x")
    verified = rodeo(dao, "verify", str(dao.site.data_dir / "store" / f"{sha256}.mcap"), status=1)
    assert (
        f"a person's statement with a valid seal; software cannot check whether it is true {word}" in verified
    )
    assert [dao.task(one)["state"] for one in (first, second)] == ["settled", "failed"]


def test_a_photo_that_is_no_picture_is_not_handed_in(dao: Dao, tmp_path: Path) -> None:
    rodeo(dao, "organization", "kind", "sweeping", "--judge", "auditor")
    service = (
        rodeo(dao, "service", "offer", "sweeping", "--price", "5", "--as", "alice").split()[-1].rstrip(".")
    )
    task_id = dao.post("6", kind="sweeping", params={})
    rodeo(dao, "task", "accept", str(task_id), "--as", "alice")
    fake = tmp_path / "fake.jpg"
    fake.write_bytes(b"\xff\xd8\xff\xe0 a few letters")
    submit = ("task", "submit", str(task_id), "--as", "alice", "--note", "x", "--photo", str(fake))
    assert "bad_photo" in rodeo(dao, *submit, status=1)
    assert (dao.task(task_id)["state"], dao.task(task_id)["accepted"]) == ("assigned", True)
    assert f"alice has given back task {task_id}" in rodeo(
        dao, "task", "abandon", str(task_id), "--as", "alice"
    )
    waits = dao.task(task_id)
    assert (waits["state"], [one["provider_name"] for one in waits["passed"]]) == ("open", ["alice"])
    assert "not offered again to alice" in rodeo(dao, "task", "show", str(task_id))
    told = rodeo(dao, "task", "match", str(task_id), "--service", service, status=1)
    assert "the service is busy, rests, costs too much, or does not do this task" in told


def test_the_oracle_posts_nothing_on_a_kind_that_it_has_no_checks_for(dao: Dao, tmp_path: Path) -> None:
    kind = ("organization", "kind", "polishing", "--judge")
    assert "kind_without_checks" in rodeo(dao, *kind, "oracle", status=1)
    rodeo(dao, *kind, "auditor")
    photo = tmp_path / "photo.png"
    cv2.imwrite(str(photo), scene(5))
    before = dao.running.status("oracle").details.get("for_auditors", 0)
    task_id = handed_in(dao, "polishing", "alice", "It shines.", photo)
    status = dao.running.wait_for_status("oracle", lambda one: one.details.get("for_auditors", 0) > before)
    assert status.details["decided"] == 0
    assert f"task {task_id} attempt 1 of polishing waits for an auditor" in dao.running.log("oracle")
    assert dao.task(task_id)["state"] == "submitted"
    verdict = ("task", "judge", str(task_id), "--reason", "There is no such handle")
    assert "give one ruling" in rodeo(dao, *verdict, status=1)
    assert f"Task {task_id} is impossible" in rodeo(dao, *verdict, "--impossible")
    assert (dao.task(task_id)["state"], dao.task(task_id)["paid_iec"]) == ("settled", "0.5")
