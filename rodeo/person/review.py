"""What is known of a person's statement, for the auditor who judges it: nothing of it refuses anything.

Each photo is compared with those of all other submissions, earlier and later ones: a thief can hand in a copy
first, so who copied whom is for the auditor to find out. Submissions are known from the contract's events,
their photos from the store. What was read of a proof is kept under its hash in a folder, which may be
deleted: it is read again then.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, ValidationError

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, Task
from rodeo.bus.queries import A, Query
from rodeo.evidence.errors import EvidenceError, StoreError
from rodeo.evidence.store import Store
from rodeo.host.files import replace_file
from rodeo.kinds import kinds_of
from rodeo.person.photo_code import photo_code
from rodeo.person.statement import BadPhoto, NotSubmitted, Statement, check_photo, fetch_statement
from rodeo.site.config import Site

READ_FOR_S = 20.0
"""Wall time for reading submissions that were not read before; the next review continues from there."""
_VERSION = "prints-1"
"""Version of what is kept; another way to make prints takes another name."""


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Use(_Frozen):
    """Another submission that holds the same."""

    task_id: int
    attempt: int
    executor: str
    """Name of the participant, or the address."""
    submitted_s: float
    photo: int | None = None
    """Which of its photos, from 1; None for the note."""
    differing_bits: int = 0
    """Number of bits in which the perceptual hashes of a photo and its near copy differ."""


class PhotoMetadata(_Frozen):
    """What the photo's EXIF says; anybody can write anything there."""

    taken: str | None
    device: str | None
    software: str | None
    has_place: bool


class PhotoReview(_Frozen):
    number: int
    """From 1."""
    sha256: str
    problem: str
    """Why it is no picture; empty when it is one."""
    width_px: int = 0
    height_px: int = 0
    metadata: PhotoMetadata | None = None
    exact_copies: list[Use] = []
    near_copies: list[Use] = []


class Review(_Frozen):
    """What an auditor should have seen before the verdict."""

    type: Literal["review"] = "review"
    task_id: int
    attempt: int
    proof_sha256: str
    note: str
    code: str
    """What a photo should show: `photo_code` of the assignment's nonce."""
    assigned_s: float | None
    same_note: list[Use]
    photos: list[PhotoReview]
    compared: int
    """Other submissions it was compared with."""
    unread: int
    """Submissions that could not be compared: their store is away, or there was no time to read them yet."""

    def lines(self) -> list[str]:
        """The same in sentences."""
        told = [f"One photo should show the code {self.code}."] if self.photos else ["There is no photo."]
        told += [f"The note has the words of {_of(use)}." for use in self.same_note]
        for photo in self.photos:
            told += [f"Photo {photo.number} {sentence}" for sentence in _sentences(photo)]
        told.append(f"Compared with {self.compared} other submissions.")
        if self.unread:
            told.append(f"{self.unread} other submissions could not be read yet; ask again.")
        return told


class Submission(_Frozen):
    """A proof as the chain names it."""

    task_id: int
    attempt: int
    executor: str
    submitted_s: float
    proof_sha256: str
    uri: str


class _Read(_Frozen):
    """What was read of a proof; empty when it holds no statement."""

    note_sha256: str = ""
    photos: list[tuple[str, str]] = []
    """SHA-256 of the bytes, and the perceptual print as text; an empty one for what is no picture."""


class Index(Protocol):
    """Asks the index of the chain, as `Participant` does."""

    def ask(self, query: Query[A], **parameters: Any) -> A: ...


class Reviewer:
    """Reviews statements; keeps what it read of proofs in `site.data_dir`."""

    def __init__(self, site: Site, index: Index, read_for_s: float = READ_FOR_S) -> None:
        self._store = Store(site)
        self._kinds = kinds_of(site)
        self._index = index
        self._folder = site.data_dir / "statements" / _VERSION
        self._read_for_s = read_for_s

    def review(self, task: Task) -> Review:
        """The review of the statement that was last submitted for `task`.

        Raises NotSubmitted, NoStatement, EvidenceError where its own proof cannot be read, and what the index
        raises.
        """
        if task.proof_sha256 is None:
            raise NotSubmitted("no proof of this task was submitted", task_id=task.id, state=task.state)
        statement = fetch_statement(self._store, task.proof_uri or "", task.proof_sha256)
        names = {one.address.lower(): one.name for one in self._index.ask(queries.WALLETS).wallets}
        others = [
            one.model_copy(update={"executor": names.get(one.executor.lower(), one.executor)})
            for one in self.submissions()
            if (one.task_id, one.attempt) != (task.id, task.attempt)
        ]
        read, unread = self._read_all(others)
        note = _note_digest(statement.note)
        return Review(
            task_id=task.id,
            attempt=task.attempt,
            proof_sha256=task.proof_sha256,
            note=statement.note,
            code=photo_code(task.nonce or ""),
            assigned_s=task.assigned,
            same_note=[_use(one) for one, found in read if found.note_sha256 == note],
            photos=[_review_photo(number, statement, read) for number in range(1, len(statement.photos) + 1)],
            compared=len(read),
            unread=unread,
        )

    def submissions(self) -> list[Submission]:
        """Those of kinds that people do, in chain order, without what a reorganization took back."""
        kinds: dict[int, str] = {}
        found: dict[int, Submission] = {}
        for event in self._events():
            args = event.args
            if event.name == "EventUndone":
                found.pop(int(args["undone_seq"]), None)
            elif event.task_id is None:
                continue
            elif event.name == "TaskRegistered":
                kinds[event.task_id] = str(args["kind"])
            elif self._kinds.by_people(kinds.get(event.task_id, "")):
                found[event.seq] = Submission(
                    task_id=event.task_id,
                    attempt=int(args["attempt"]),
                    executor=str(args["executor"]),
                    submitted_s=event.time_s,
                    proof_sha256=str(args["proof_hash"]).lower(),
                    uri=str(args["uri"]),
                )
        return list(found.values())

    def _events(self) -> Iterator[DaoEvent]:
        after = 0
        while True:
            wanted = "TaskRegistered,ProofSubmitted,EventUndone"
            events = self._index.ask(queries.EVENTS, after=after, name=wanted).events
            yield from events
            if not events:
                return
            after = events[-1].seq

    def _read_all(self, submissions: list[Submission]) -> tuple[list[tuple[Submission, _Read]], int]:
        """What was read of each, in order, and how many could not be read; the newest are read first."""
        deadline_s = time.monotonic() + self._read_for_s
        read: list[tuple[Submission, _Read]] = []
        unread = 0
        for one in reversed(submissions):
            found = self._kept(one)
            if found is None and time.monotonic() < deadline_s:
                found = self._read(one)
            if found is None:
                unread += 1
            else:
                read.append((one, found))
        return read[::-1], unread

    def _path(self, one: Submission) -> Path:
        return self._folder / f"{one.proof_sha256.removeprefix('0x')}.json"

    def _kept(self, one: Submission) -> _Read | None:
        try:
            return _Read.model_validate_json(self._path(one).read_bytes())
        except (OSError, ValidationError):  # not there, or of another program: read again
            return None

    def _read(self, one: Submission) -> _Read | None:
        """From the store; None where the store does not have it now."""
        from rodeo.vision.likeness import photo_print, to_text

        try:
            statement = fetch_statement(self._store, one.uri, one.proof_sha256)
        except StoreError:
            return None
        except EvidenceError:
            found = _Read()
        else:
            photos = []
            for photo in statement.photos:
                try:
                    text = to_text(photo_print(check_photo(photo)))
                except BadPhoto:
                    text = ""
                photos.append((_sha256(photo), text))
            found = _Read(note_sha256=_note_digest(statement.note), photos=photos)
        self._folder.mkdir(parents=True, exist_ok=True)
        replace_file(self._path(one), found.model_dump_json())
        return found


def _review_photo(number: int, statement: Statement, read: list[tuple[Submission, _Read]]) -> PhotoReview:
    from rodeo.vision.likeness import COPY_BITS, differing_bits, from_text, turned_prints
    from rodeo.vision.metadata import read_metadata

    data = statement.photos[number - 1]
    sha256 = _sha256(data)
    exact = [
        _use(one, place)
        for one, found in read
        for place, (other, _) in enumerate(found.photos, start=1)
        if other == sha256
    ]
    try:
        picture = check_photo(data)
    except BadPhoto as error:
        return PhotoReview(number=number, sha256=sha256, problem=str(error), exact_copies=exact)
    turned = turned_prints(picture)
    near = [
        _use(one, place, bits)
        for one, found in read
        for place, (other, text) in enumerate(found.photos, start=1)
        if other != sha256 and text and (bits := differing_bits(turned, from_text(text))) < COPY_BITS
    ]
    metadata = read_metadata(data)
    return PhotoReview(
        number=number,
        sha256=sha256,
        problem="",
        width_px=picture.shape[1],
        height_px=picture.shape[0],
        metadata=None if metadata is None else PhotoMetadata(**vars(metadata)),
        exact_copies=exact,
        near_copies=near,
    )


def _use(one: Submission, photo: int | None = None, bits: int = 0) -> Use:
    return Use(
        task_id=one.task_id,
        attempt=one.attempt,
        executor=one.executor,
        submitted_s=one.submitted_s,
        photo=photo,
        differing_bits=bits,
    )


def _sentences(photo: PhotoReview) -> Iterator[str]:
    if photo.problem:
        yield f"cannot be shown: {photo.problem}."
    else:
        yield f"has {photo.width_px} x {photo.height_px} pixels; {_described(photo.metadata)}."
    for use in photo.exact_copies:
        yield f"is photo {use.photo} of {_of(use)}, byte for byte."
    for use in photo.near_copies:
        yield f"looks like photo {use.photo} of {_of(use)}."


def _described(metadata: PhotoMetadata | None) -> str:
    if metadata is None:
        return "it has no metadata"
    told = [
        f"taken {metadata.taken}" if metadata.taken else "no time",
        f"with {metadata.device}" if metadata.device else "no device",
        *([f"changed by {metadata.software}"] if metadata.software else []),
        *(["a place is noted"] if metadata.has_place else []),
    ]
    return f"its metadata says: {', '.join(told)}"


def _of(use: Use) -> str:
    when = datetime.fromtimestamp(use.submitted_s, UTC).strftime("%Y-%m-%d %H:%M (site time)")
    return f"task {use.task_id} attempt {use.attempt}, handed in by {use.executor} on {when}"


def _sha256(data: bytes) -> str:
    return "0x" + hashlib.sha256(data).hexdigest()


def _note_digest(note: str) -> str:
    """The same for notes that differ in spaces and capitals only."""
    return _sha256(" ".join(note.casefold().split()).encode())
