"""Statements: a person's note and photos, bound to the assignment and sealed with the person's own key."""

from __future__ import annotations

import hashlib
from decimal import Decimal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from eth_account import Account

from rodeo.bus.messages import Ruling
from rodeo.evidence.errors import RecordingSealed
from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.seal import Binding
from rodeo.evidence.store import Store
from rodeo.person.statement import (
    MAX_PHOTO_BYTES,
    PHOTO_TOPIC,
    PHOTO_TYPE,
    BadAmount,
    BadNote,
    BadPhoto,
    BadReason,
    Executor,
    NoStatement,
    NotAccepted,
    NotYourTask,
    check_photo,
    judge,
    photo_cdr,
    read_statement,
)
from rodeo.site.config import Site
from tests.support.site import LAB
from tests.support.tasks import task

ALICE = Account.create()
PICTURE = np.random.default_rng(1).integers(0, 256, (60, 80, 3), dtype=np.uint8)
JPEG, PNG = (cv2.imencode(extension, PICTURE)[1].tobytes() for extension in (".jpg", ".png"))
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


NOW_NS = 1_700_000_000_000_000_000


class Clock:
    def __init__(self) -> None:
        self.time_ns = NOW_NS

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
        self.accepted: list[int] = []

    def task(self, task_id: int) -> Any:
        return self.assigned

    def accept_task(self, task: Any) -> None:
        self.accepted.append(task.id)

    def binding(self, _task: Any, _device: str) -> Binding:
        return BINDING

    def submit_proof(
        self, task_id: int, attempt: int, sha256: str, uri: str, nonce: str | None = None
    ) -> None:
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
    assert dao.accepted == [1]
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


def png_of(width_px: int, height_px: int) -> bytes:
    """A PNG whose header tells of so many pixels."""
    return PNG[:16] + width_px.to_bytes(4) + height_px.to_bytes(4) + PNG[24:]


def embedded_thumbnail() -> bytes:
    """A JPEG that carries a whole small one among its segments, and is cut in its own data."""
    thumbnail = cv2.imencode(".jpg", PICTURE[:16, :16])[1].tobytes()
    segment = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2) + thumbnail
    return JPEG[:2] + segment + JPEG[2:-400]


NO_PHOTOS = {
    "nothing": b"",
    "another format": b"GIF89a",
    "too many bytes": b"\xff\xd8\xff" + bytes(MAX_PHOTO_BYTES),
    "a JPEG's first bytes": b"\xff\xd8\xff\xe0" + bytes(range(200)),
    "a PNG's first bytes": b"\x89PNG\r\n\x1a\n" + bytes(50),
    "too many pixels": png_of(60_000, 60_000),
    "a JPEG cut in half": JPEG[: len(JPEG) // 2],
    "a cut JPEG with a whole thumbnail": embedded_thumbnail(),
    "a PNG cut in half": PNG[: len(PNG) // 2],
    "a JPEG without its data": JPEG[: JPEG.index(b"\xff\xda") + 14],
}


@pytest.mark.parametrize("photo", NO_PHOTOS.values(), ids=NO_PHOTOS.keys())
def test_what_is_no_picture_is_not_handed_in(site: Site, photo: bytes) -> None:
    dao = Dao()
    person = executor(site, dao)
    person.accept(1)
    with pytest.raises(BadPhoto):
        person.submit(1, "All clean.", [JPEG, photo])
    assert dao.submitted == []
    person.submit(1, "All clean.", [JPEG])  # nothing was sealed meanwhile


def test_a_photo_with_something_behind_its_picture_is_a_photo() -> None:
    """As telephones make them that keep a moment's film with each."""
    assert check_photo(JPEG + b"film \xff\xda and more").shape == PICTURE.shape


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


class Auditor:
    """Judges one task and remembers what was posted."""

    name = "organization"

    def __init__(self, kind: str, proof: Path) -> None:
        sha256 = proof.stem
        proof_of = {"proof_sha256": "0x" + sha256, "proof_uri": f"file://{proof}"}
        self._task = task("submitted").model_copy(update={"kind": kind, "price_iec": Decimal(80), **proof_of})
        self.posted: list[Any] = []

    def task(self, _task_id: int) -> Any:
        return self._task

    def command(self, name: str, request: Any) -> None:
        self.posted.append((name, request))


def by_another_program(site: Site, tmp_path: Path, photo: bytes) -> Path:
    """A stored proof that was sealed without asking whether its photo is one."""
    recorder = Recorder(tmp_path / "r.mcap", BINDING, ALICE, Clock())  # type: ignore[arg-type]
    recorder.write_ros(PHOTO_TOPIC, PHOTO_TYPE, photo_cdr(photo, "jpeg", NOW_NS), NOW_NS, NOW_NS)
    digest = "0x" + hashlib.sha256(photo).hexdigest()
    recorder.write_json("rodeo/event", {"event": "statement", "note": "x", "photos_sha256": [digest]})
    uri = Store(site).put(recorder.close().path)
    return Path(uri.removeprefix("file://"))


def test_a_proof_whose_photo_is_no_picture_can_be_rejected_and_not_accepted(
    site: Site, tmp_path: Path
) -> None:
    auditor = Auditor("wheel_cleaning", by_another_program(site, tmp_path, b"\xff\xd8\xff\xe0 no photo"))
    with pytest.raises(BadPhoto):
        judge(site, auditor, 1, "accepted", reason="clean")  # type: ignore[arg-type]
    assert auditor.posted == []
    judge(site, auditor, 1, "rejected", reason="no photo")  # type: ignore[arg-type]
    judge(site, auditor, 1, "void", "locked", fault="creator")  # type: ignore[arg-type]
    said = [(request.ruling, request.fault) for _, request in auditor.posted]
    assert said == [("rejected", "nobody"), ("void", "creator")]
    assert [request.amount_iec for _, request in auditor.posted] == [None, None]


def test_a_proof_with_a_picture_is_accepted(site: Site, tmp_path: Path) -> None:
    auditor = Auditor("wheel_cleaning", by_another_program(site, tmp_path, JPEG))
    judge(site, auditor, 1, "accepted", reason="clean")  # type: ignore[arg-type]
    assert len(auditor.posted) == 1


def test_accepted_work_is_paid_its_price_or_what_the_auditor_says(site: Site, tmp_path: Path) -> None:
    auditor = Auditor("waste_disposal", by_another_program(site, tmp_path, JPEG))
    judge(site, auditor, 1, "accepted", reason="clean")  # type: ignore[arg-type]
    judge(site, auditor, 1, "accepted", "half of it", Decimal("40.5"))  # type: ignore[arg-type]
    judge(site, auditor, 1, "rejected", reason="dirty")  # type: ignore[arg-type]
    said = [(request.ruling, request.amount_iec) for _, request in auditor.posted]
    assert said == [("accepted", 80), ("accepted", Decimal("40.5")), ("rejected", None)]


@pytest.mark.parametrize("reason", ["", " \n", "x" * 501])
def test_no_auditor_judges_without_a_reason_that_fits(site: Site, tmp_path: Path, reason: str) -> None:
    auditor = Auditor("waste_disposal", by_another_program(site, tmp_path, JPEG))
    with pytest.raises(BadReason) as refused:
        judge(site, auditor, 1, "accepted", reason=reason)  # type: ignore[arg-type]
    assert refused.value.details == {"characters": len(reason), "limit": 500}
    assert auditor.posted == []


@pytest.mark.parametrize(
    ("ruling", "amount"), [("accepted", "80.1"), ("accepted", "0"), ("accepted", "-1"), ("rejected", "1")]
)
def test_no_auditor_pays_above_the_price_nothing_or_for_what_it_rejects(
    site: Site, tmp_path: Path, ruling: Ruling, amount: str
) -> None:
    auditor = Auditor("waste_disposal", by_another_program(site, tmp_path, JPEG))
    with pytest.raises(BadAmount) as refused:
        judge(site, auditor, 1, ruling, "so", Decimal(amount))  # type: ignore[arg-type]
    assert refused.value.details["price_iec"] == "80"
    assert auditor.posted == []


def test_of_a_robots_work_an_auditor_needs_no_statement(site: Site, tmp_path: Path) -> None:
    auditor = Auditor("waste_disposal", by_another_program(site, tmp_path, b"no photo"))
    judge(site, auditor, 1, "accepted", reason="seen it")  # type: ignore[arg-type]
    assert len(auditor.posted) == 1
