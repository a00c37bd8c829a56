"""What an auditor is shown of a person's statement: exact and near copies, whenever used, and metadata."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from eth_account import Account

from rodeo.bus.messages import Task
from rodeo.bus.queries import A, Query
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.seal import Binding
from rodeo.evidence.store import Store
from rodeo.person.photo_code import photo_code
from rodeo.person.review import Review, Reviewer
from rodeo.person.statement import PHOTO_TOPIC, PHOTO_TYPE, NotSubmitted, photo_cdr
from rodeo.site.config import Site
from rodeo_testing import answers
from tests.support.site import LAB
from tests.support.tasks import task
from tests.unit.person.test_statement import ALICE, BINDING, Clock
from tests.unit.vision.test_likeness import jpeg, scene
from tests.unit.vision.test_metadata import exif

BOB = Account.create()


def encoded(picture: np.ndarray, quality: int = 90) -> bytes:
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


WHEELS, FLOOR = encoded(scene(1)), encoded(scene(2))


class Chain:
    """Submissions as the index tells them, with their proofs in the site's store."""

    def __init__(self, site: Site, folder: Path) -> None:
        self._site = site
        self._folder = folder
        self.events: list[dict[str, Any]] = []
        self.tasks: dict[int, Task] = {}

    def ask(self, query: Query[A], **parameters: Any) -> A:
        names = parameters.get("name", "").split(",")
        after = parameters.get("after", 0)
        events = [one for one in self.events if one["seq"] > after and one["name"] in names][:2]
        known = {"wallets": answers.wallets({"alice": ALICE.address}), "events": answers.events(events)}
        return answers.answered(query, known)

    def submit(
        self, task_id: int, note: str, *photos: bytes, by: Any = ALICE, kind: str = "wheel_cleaning"
    ) -> int:
        """Seal, store and submit; returns the submission's sequence number."""
        path = self._folder / f"{task_id}-{len(self.events)}.mcap"
        binding = Binding(**{**BINDING.model_dump(), "task_id": task_id, "executor": by.address})
        recorder = Recorder(path, binding, by, Clock())  # type: ignore[arg-type]
        for photo in photos:
            now_ns = Clock().now_ns()
            recorder.write_ros(PHOTO_TOPIC, PHOTO_TYPE, photo_cdr(photo, "jpeg", now_ns), now_ns, now_ns)
        digests = ["0x" + hashlib.sha256(photo).hexdigest() for photo in photos]
        recorder.write_json("rodeo/event", {"event": "statement", "note": note, "photos_sha256": digests})
        return self.submit_file(task_id, recorder.close().path, by, kind)

    def submit_file(self, task_id: int, path: Path, by: Any = BOB, kind: str = "wheel_cleaning") -> int:
        """Store a recording and submit it."""
        uri = Store(self._site).put(path)
        sha256 = Store.hash_of(uri)
        if task_id not in self.tasks:
            self._emit("TaskRegistered", task_id, {"kind": kind})
        self.tasks[task_id] = task("submitted").model_copy(
            update={"id": task_id, "kind": kind, "nonce": BINDING.nonce, "assigned": 1_600_000_000.0,
                    "proof_sha256": sha256, "proof_uri": uri}
        )  # fmt: skip
        args = {"attempt": 1, "executor": by.address, "proof_hash": sha256, "uri": uri}
        return self._emit("ProofSubmitted", task_id, args)

    def undo(self, seq: int) -> None:
        self._emit("EventUndone", None, {"undone_seq": seq, "undone_name": "ProofSubmitted"})

    def _emit(self, name: str, task_id: int | None, args: dict[str, Any]) -> int:
        seq = len(self.events) + 1
        event = {"seq": seq, "name": name, "block": seq, "log_index": 0, "tx_hash": "0x", "task_id": task_id}
        self.events.append(event | {"time_s": 1_700_000_000.0 + seq, "args": args})
        return seq


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site.load(LAB).model_copy(update={"data_dir": tmp_path / "data"})


@pytest.fixture
def chain(site: Site, tmp_path: Path) -> Chain:
    return Chain(site, tmp_path)


def reviewed(site: Site, chain: Chain, task_id: int, read_for_s: float = 60.0) -> Review:
    return Reviewer(site, chain, read_for_s).review(chain.tasks[task_id])


def test_a_photo_that_was_used_before_is_shown_with_task_attempt_and_who(site: Site, chain: Chain) -> None:
    chain.submit(1, "wheels", WHEELS, FLOOR)
    chain.submit(2, "other words", FLOOR, by=BOB)
    found = reviewed(site, chain, 2)
    ((use,),) = [photo.exact_copies for photo in found.photos]
    assert (use.task_id, use.attempt, use.executor, use.photo) == (1, 1, "alice", 2)
    assert found.photos[0].near_copies == []
    assert any("photo 2 of task 1 attempt 1, handed in by alice" in line for line in found.lines())


def test_who_handed_in_first_is_shown_the_later_copy_too(site: Site, chain: Chain) -> None:
    """The thief may be the first."""
    chain.submit(1, "wheels", WHEELS)
    chain.submit(2, "other words", WHEELS, by=BOB)
    (photo,) = reviewed(site, chain, 1).photos
    assert [(use.task_id, use.executor) for use in photo.exact_copies] == [(2, BOB.address)]


@pytest.mark.parametrize("copy", ["encoded again", "smaller", "cut", "mirrored"])
def test_a_changed_copy_is_shown_as_near(site: Site, chain: Chain, copy: str) -> None:
    picture = {
        "encoded again": jpeg(scene(1), 30),
        "smaller": cv2.resize(scene(1), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA),
        "cut": scene(1)[10:, 12:],
        "mirrored": scene(1)[:, ::-1],
    }[copy]
    chain.submit(1, "wheels", FLOOR, WHEELS)
    chain.submit(2, "other words", encoded(picture), by=BOB)
    (photo,) = reviewed(site, chain, 2).photos
    assert photo.exact_copies == []
    assert [(use.task_id, use.photo) for use in photo.near_copies] == [(1, 2)]


def test_photos_of_different_things_are_shown_as_no_copies(site: Site, chain: Chain) -> None:
    chain.submit(1, "wheels", WHEELS)
    chain.submit(2, "floor", FLOOR)
    found = reviewed(site, chain, 2)
    assert (found.photos[0].exact_copies, found.photos[0].near_copies, found.same_note) == ([], [], [])
    assert (found.compared, found.unread) == (1, 0)


def test_the_same_words_are_shown_whatever_their_capitals_and_spaces(site: Site, chain: Chain) -> None:
    chain.submit(1, "All  wheels are clean.")
    chain.submit(2, "all wheels are\nclean. ", by=BOB)
    (use,) = reviewed(site, chain, 2).same_note
    assert (use.task_id, use.photo) == (1, None)


def test_a_robots_proofs_are_not_read(site: Site, chain: Chain) -> None:
    chain.submit(1, "wheels", WHEELS, kind="waste_disposal")
    chain.submit(2, "wheels", WHEELS)
    assert reviewed(site, chain, 2).compared == 0


def test_what_a_reorganization_took_back_was_never_used(site: Site, chain: Chain) -> None:
    chain.undo(chain.submit(1, "wheels", WHEELS))
    chain.submit(2, "other words", WHEELS)
    assert reviewed(site, chain, 2).photos[0].exact_copies == []


def test_metadata_and_the_code_are_shown_and_no_metadata_too(site: Site, chain: Chain) -> None:
    block = [np.frombuffer(exif(), np.uint8)]
    told = cv2.imencodeWithMetadata(".jpg", scene(3), [cv2.IMAGE_METADATA_EXIF], block)[1].tobytes()
    chain.submit(1, "wheels", told, WHEELS)
    found = reviewed(site, chain, 1)
    assert found.photos[0].metadata is not None
    assert (found.photos[0].metadata.taken, found.photos[0].metadata.device) == (
        "2026:11:21 10:00:00",
        "Acme",
    )
    assert found.photos[1].metadata is None
    assert found.code == photo_code(BINDING.nonce)
    assert any(found.code in line for line in found.lines())


def test_what_is_no_picture_is_shown_as_such_and_its_exact_copy_found(site: Site, chain: Chain) -> None:
    fake = b"\xff\xd8\xff\xe0 no photo"
    chain.submit(1, "wheels", fake)
    chain.submit(2, "other words", fake, WHEELS)
    first, second = reviewed(site, chain, 2).photos
    assert "not an image" in first.problem
    assert [use.task_id for use in first.exact_copies] == [1]
    assert second.problem == ""


def test_the_index_can_be_deleted_and_proofs_are_read_only_once(site: Site, chain: Chain) -> None:
    chain.submit(1, "wheels", WHEELS)
    chain.submit(2, "other words", WHEELS)
    before = reviewed(site, chain, 2)
    shutil.rmtree(site.data_dir / "statements")
    assert reviewed(site, chain, 2) == before
    Path((chain.tasks[1].proof_uri or "").removeprefix("file://")).unlink()
    assert reviewed(site, chain, 2) == before


def test_what_could_not_be_read_is_counted_and_read_when_it_can_be(site: Site, chain: Chain) -> None:
    chain.submit(1, "wheels", WHEELS)
    chain.submit(2, "other words", WHEELS)
    hurried = reviewed(site, chain, 2, read_for_s=0.0)
    assert (hurried.compared, hurried.unread) == (0, 1)
    assert any("could not be read yet" in line for line in hurried.lines())
    assert (reviewed(site, chain, 2).compared, reviewed(site, chain, 2).unread) == (1, 0)


def test_a_task_without_a_proof_has_nothing_to_review(site: Site, chain: Chain) -> None:
    with pytest.raises(NotSubmitted):
        Reviewer(site, chain).review(task("assigned"))


def test_a_hostile_submission_keeps_nobody_from_reviewing_others(
    site: Site, chain: Chain, tmp_path: Path
) -> None:
    chain.submit(1, "wheels", WHEELS)
    malformed, many = tmp_path / "malformed.mcap", tmp_path / "many.mcap"
    for path, messages in ((malformed, [b"\0\1\0\0"]), (many, [photo_cdr(b"x", "jpeg", 1)] * 9)):
        recorder = Recorder(path, BINDING, BOB, Clock())  # type: ignore[arg-type]
        for message in messages:
            now_ns = Clock().now_ns()
            recorder.write_ros(PHOTO_TOPIC, PHOTO_TYPE, message, now_ns, now_ns)
        said = {"event": "statement", "note": "other words", "photos_sha256": []}
        recorder.write_json("rodeo/event", said)
        chain.submit_file(5, recorder.close().path)
    chain.submit(6, "yet other words", WHEELS)
    found = reviewed(site, chain, 6)
    assert (found.compared, found.unread) == (3, 0)
    assert [use.task_id for use in found.photos[0].exact_copies] == [1]
