"""Statements: a person's note and photos, bound to the assignment and sealed with the person's own key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from eth_account import Account

from rodeo.config import Site
from rodeo.evidence import Binding, Recorder, open_proof
from rodeo.evidence.errors import RecordingSealed
from rodeo.evidence.statement import (
    MAX_PHOTO_BYTES,
    BadNote,
    BadPhoto,
    Executor,
    NoStatement,
    NotAccepted,
    NotYourTask,
    photo_format,
    read_statement,
)
from tests.support.site import LAB
from tests.unit.services.robot_agent.test_decision import task

ALICE = Account.create()
JPEG = b"\xff\xd8\xff\xe0" + bytes(range(200))
PNG = b"\x89PNG\r\n\x1a\n" + bytes(50)
BINDING = Binding(
    chain_id=1,
    task_manager="0x" + "11" * 20,
    organization="0x" + "34" * 20,
    device="alice",
    task_id=1,
    attempt=1,
    executor=ALICE.address,
    nonce="0x" + "22" * 32,
)


class Clock:
    def __init__(self) -> None:
        self.time_ns = 1_700_000_000_000_000_000

    def now_ns(self) -> int:
        self.time_ns += 1_000_000
        return self.time_ns


class Dao:
    """A participant whose task is assigned to `executor`; the first submissions fail as `down` says."""

    def __init__(self, executor: str = "alice") -> None:
        self.name = "alice"
        self.assigned = task("assigned").model_copy(update={"executor_name": executor})
        self.down = 0
        self.submitted: list[tuple[int, int, str, str]] = []

    def task(self, task_id: int) -> Any:
        return self.assigned

    def binding(self, _task: Any, _device: str) -> Binding:
        return BINDING

    def submit_proof(self, task_id: int, attempt: int, sha256: str, uri: str) -> None:
        if self.down:
            self.down -= 1
            raise ConnectionError
        self.submitted.append((task_id, attempt, sha256, uri))


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site.load(LAB).model_copy(update={"data_dir": tmp_path})


def executor(site: Site, dao: Dao) -> Executor:
    return Executor(site, dao, ALICE, Clock())  # type: ignore[arg-type]


def test_what_was_handed_in_is_in_the_proof_that_the_hash_on_chain_names(site: Site) -> None:
    dao = Dao()
    executor(site, dao).accept(1)
    sha256 = executor(site, dao).submit(1, "All clean.", [JPEG, PNG])
    ((task_id, attempt, on_chain, uri),) = dao.submitted
    assert (task_id, attempt, on_chain) == (1, 1, sha256)
    proof = open_proof(uri.removeprefix("file://"))
    assert (proof.sha256, proof.signer, proof.binding) == (sha256, ALICE.address, BINDING)
    statement = read_statement(proof)
    assert (statement.note, statement.photos) == ("All clean.", (JPEG, PNG))


def test_accepting_twice_changes_nothing(site: Site) -> None:
    dao = Dao()
    executor(site, dao).accept(1)
    before = next(site.data_dir.rglob("*.mcap")).read_bytes()
    executor(site, dao).accept(1)
    assert next(site.data_dir.rglob("*.mcap")).read_bytes() == before


def test_a_submission_that_was_cut_off_goes_on_with_what_was_sealed(site: Site) -> None:
    dao = Dao()
    dao.down = 1
    executor(site, dao).accept(1)
    with pytest.raises(ConnectionError):
        executor(site, dao).submit(1, "All clean.", [JPEG])
    executor(site, dao).submit(1, "All clean.", [JPEG])
    (submitted,) = dao.submitted
    assert read_statement(open_proof(submitted[3].removeprefix("file://"))).note == "All clean."


def test_another_ones_task_can_be_neither_accepted_nor_submitted(site: Site) -> None:
    person = executor(site, Dao(executor="bob"))
    with pytest.raises(NotYourTask) as caught:
        person.accept(1)
    assert caught.value.details["executor"] == "bob"
    with pytest.raises(NotYourTask):
        person.submit(1, "All clean.")


def test_what_was_not_accepted_cannot_be_submitted(site: Site) -> None:
    with pytest.raises(NotAccepted):
        executor(site, Dao()).submit(1, "All clean.")


@pytest.mark.parametrize("note", ["", "  ", "x" * 4001])
def test_a_note_has_to_say_something_in_a_page(site: Site, note: str) -> None:
    person = executor(site, Dao())
    person.accept(1)
    with pytest.raises(BadNote):
        person.submit(1, note)


@pytest.mark.parametrize("photo", [b"", b"GIF89a", b"\xff\xd8\xff" + bytes(MAX_PHOTO_BYTES)])
def test_only_pictures_of_a_reasonable_size_are_taken(photo: bytes) -> None:
    with pytest.raises(BadPhoto):
        photo_format(photo)


def test_a_recording_without_a_statement_is_none(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r.mcap", BINDING, ALICE, Clock())  # type: ignore[arg-type]
    recorder.write_json("rodeo/event", {"event": "accepted"})
    sealed = recorder.close()
    with pytest.raises(NoStatement):
        read_statement(open_proof(sealed.path))
    with pytest.raises(RecordingSealed):
        recorder.write_json("rodeo/event", {"event": "late"})


def test_photos_that_are_not_those_of_the_statement_are_not_believed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r.mcap", BINDING, ALICE, Clock())  # type: ignore[arg-type]
    recorder.write_json("rodeo/event", {"event": "statement", "note": "x", "photos_sha256": ["0x00"]})
    with pytest.raises(NoStatement):
        read_statement(open_proof(recorder.close().path))
