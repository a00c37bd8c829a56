"""Proofs by those who have no body of their own: a sealed recording that holds a note and photographs.

A person accepts an assignment, which opens a recording bound to it, does the work, and submits: the evidence
is added, the recording sealed with the person's own key, stored, and its hash put on chain. The seal proves
who said it, for which assignment, and when. Whether it is true is for an auditor to judge, who learns from
`rodeo.person.review` what is known of note and photos.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from hashlib import sha256
from pathlib import Path

import numpy as np

from rodeo.bus.messages import Fault, Ruling, Task
from rodeo.commands.judging import Rule
from rodeo.dao import Participant
from rodeo.errors import RequestError
from rodeo.evidence.container import Limits
from rodeo.evidence.errors import EvidenceError, RecordingSealed
from rodeo.evidence.proof import Proof, open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.store import Store
from rodeo.host.clock import Clock
from rodeo.kinds import kinds_of
from rodeo.ros2 import types
from rodeo.ros2.errors import MalformedMessage
from rodeo.signing.keys import Signer
from rodeo.site.config import Site
from rodeo.site.topics import EVENT_CHANNEL
from rodeo.text.strict_json import plain
from rodeo.vision.images import ImageError, decode_image, ends_early, media_type

PHOTO_TOPIC = "/statement/photo"
PHOTO_TYPE = "sensor_msgs/msg/CompressedImage"
MAX_PHOTOS = 8
MAX_PHOTO_BYTES = 8 << 20
MAX_NOTE_CHARACTERS = 4000
MAX_REASON_CHARACTERS = 500
MAX_STATEMENT_BYTES = 2 * MAX_PHOTOS * MAX_PHOTO_BYTES
"""Most bytes of a recording that holds a statement: no statement needs more."""
STATEMENT_LIMITS = Limits(
    file_bytes=MAX_STATEMENT_BYTES, uncompressed_bytes=MAX_STATEMENT_BYTES, messages=100_000
)
_FORMATS = {"image/jpeg": "jpeg", "image/png": "png"}


class NotYourTask(RequestError):
    """The task is not assigned to this participant."""


class NotAccepted(RequestError):
    """There is no recording of this assignment: accept it first."""


class NotSubmitted(RequestError):
    """There is no proof to judge."""


class BadAmount(RequestError):
    """No ruling pays this amount."""


class BadPhoto(RequestError):
    """Not a JPEG or PNG picture of a reasonable size that can be decoded to its end."""


class BadNote(RequestError):
    """The note is empty or too long."""


class BadReason(RequestError):
    """An auditor gave no reason, or one that is too long: the executor reads it, and it stays on chain."""


class NoStatement(EvidenceError):
    """The recording holds no statement."""


@dataclass(frozen=True)
class Statement:
    note: str
    photos: tuple[bytes, ...]
    """As they were handed in, JPEG or PNG."""


class Executor:
    """A participant without a body. `account` opens the keystore that its address on chain belongs to."""

    def __init__(self, site: Site, participant: Participant, account: Signer, clock: Clock) -> None:
        self._site = site
        self._dao = participant
        self._account = account
        self._clock = clock

    def accept(self, task_id: int) -> Task:
        """Agree to the task on chain, and open the assignment's recording; doing it twice changes nothing.

        Raises NotYourTask, and what `Participant` raises.
        """
        task = self._assigned(task_id)
        self._dao.accept_task(task)
        path = self._path(task)
        if not path.exists():
            with Recorder(
                path, self._dao.binding(task, self._dao.name), self._account, self._clock
            ) as recorder:
                recorder.write_json(EVENT_CHANNEL, {"event": "accepted", "executor": self._dao.name})
        return task

    def submit(self, task_id: int, note: str, photos: Sequence[bytes] = ()) -> str:
        """Add the evidence, seal, store and submit; returns the proof's SHA-256 (0x).

        Asked again after it was interrupted, it continues with what was sealed. Raises NotYourTask,
        NotAccepted, BadNote, BadPhoto, StoreUnavailable, and what `Participant` raises.
        """
        task = self._assigned(task_id)
        path = self._path(task)
        if not path.exists():
            raise NotAccepted("accept the task first", task_id=task_id)
        if not 0 < len(note.strip()) <= MAX_NOTE_CHARACTERS:
            raise BadNote("a note is missing or too long", characters=len(note), limit=MAX_NOTE_CHARACTERS)
        if note != plain(note):
            raise BadNote("the note holds what is no character", note=plain(note)[:200])
        if len(photos) > MAX_PHOTOS:
            raise BadPhoto("too many photos", photos=len(photos), limit=MAX_PHOTOS)
        for photo in photos:
            check_photo(photo)
        formats = [photo_format(photo) for photo in photos]
        try:
            recorder = Recorder.resume(
                path, self._dao.binding(task, self._dao.name), self._account, self._clock
            )
        except RecordingSealed:
            pass  # the process ended between sealing and submitting
        else:
            for photo, name in zip(photos, formats, strict=True):
                now_ns = self._clock.now_ns()
                recorder.write_ros(PHOTO_TOPIC, PHOTO_TYPE, photo_cdr(photo, name, now_ns), now_ns, now_ns)
            recorder.write_json(
                EVENT_CHANNEL,
                {
                    "event": "statement",
                    "note": note,
                    "photos_sha256": ["0x" + sha256(photo).hexdigest() for photo in photos],
                },
            )
            recorder.close()
        uri = Store(self._site).put(path)
        digest = Store.hash_of(uri)
        self._dao.submit_proof(task.id, task.attempt, digest, uri, task.nonce)
        return digest

    def _assigned(self, task_id: int) -> Task:
        task = self._dao.task(task_id)
        if task.state != "assigned" or task.executor_name != self._dao.name:
            raise NotYourTask(
                f"task {task_id} is not assigned to {self._dao.name}",
                state=task.state,
                executor=task.executor_name or task.executor,
            )
        return task

    def _path(self, task: Task) -> Path:
        folder = self._site.data_dir / "statements" / self._dao.name
        # With the nonce: on another chain, or after a reorganization, the same number is another assignment.
        nonce = (task.nonce or "").removeprefix("0x")[:16]
        return folder / f"{task.id}-{task.attempt}-{nonce}" / "recording.mcap"


def judge(
    site: Site,
    auditor: Participant,
    task_id: int,
    ruling: Ruling,
    reason: str,
    amount_iec: Decimal | None = None,
    fault: Fault = "nobody",
) -> None:
    """An auditor's ruling on the proof that was submitted for a task, with a report of its own in the store.

    Accepted work is paid `amount_iec`, by default the agreed price. `fault` says whose doing a void ruling
    is. A person's proof is only accepted if it can be read and its photos are pictures: raises NoStatement,
    BadPhoto and EvidenceError. Raises BadReason, BadAmount, StoreUnavailable, and what `Participant` raises:
    the contract refuses whoever may not judge this kind.
    """
    if not reason.strip() or len(reason) > MAX_REASON_CHARACTERS:
        raise BadReason(
            "the reason is missing or too long", characters=len(reason), limit=MAX_REASON_CHARACTERS
        )
    task, accepted = auditor.task(task_id), ruling == "accepted"
    if amount_iec is not None and not (accepted and 0 < amount_iec <= (task.price_iec or 0)):
        raise BadAmount(
            "pay accepted work more than 0 IEC and at most its price; after other rulings pay nothing",
            amount_iec=str(amount_iec),
            price_iec=str(task.price_iec),
            ruling=ruling,
        )
    if task.proof_sha256 is None or task.state not in ("submitted", "ruled"):
        raise NotSubmitted("no proof of this task waits for a ruling", task_id=task_id, state=task.state)
    if accepted and kinds_of(site).by_people(task.kind):
        for photo in fetch_statement(Store(site), task.proof_uri or "", task.proof_sha256).photos:
            check_photo(photo)
    paid_iec = (amount_iec or task.price_iec) if accepted else None
    report = {
        "kind": task.kind,
        "task_id": task.id,
        "attempt": task.attempt,
        "proof_sha256": task.proof_sha256,
        "ruling": ruling,
        "fault": fault,
        "amount_iec": None if paid_iec is None else str(paid_iec),
        "reason": reason,
        "auditor": auditor.name,
    }
    uri, digest = Store(site).put_bytes(json.dumps(report, indent=2, ensure_ascii=False).encode(), ".json")
    auditor.command(
        "rule",
        Rule(
            task_id=task.id,
            attempt=task.attempt,
            proof_sha256=task.proof_sha256,
            ruling=ruling,
            fault=fault,
            amount_iec=paid_iec,
            reason=reason,
            report_sha256=digest,
            report_uri=uri,
        ),
    )


def photo_format(photo: bytes) -> str:
    """`jpeg` or `png`, by the first bytes. Raises BadPhoto."""
    if len(photo) > MAX_PHOTO_BYTES:
        raise BadPhoto("the photo is too large", bytes=len(photo), limit=MAX_PHOTO_BYTES)
    name = _FORMATS.get(media_type(photo))
    if name is None:
        raise BadPhoto("the photo is neither JPEG nor PNG", begins=photo[:8].hex())
    return name


def check_photo(photo: bytes) -> np.ndarray:
    """The picture, BGR, uint8, shape (height, width, 3): a photo is what can be decoded, to its end and
    within the limits of pictures. Raises BadPhoto."""
    photo_format(photo)
    try:
        picture = decode_image(photo)
    except ImageError as error:
        raise BadPhoto(f"the photo is not an image: {error.message}", **error.details) from error
    if ends_early(photo):
        raise BadPhoto("the photo is cut off", bytes=len(photo))
    return picture


def fetch_statement(store: Store, uri: str, proof_sha256: str) -> Statement:
    """The statement in a stored proof; reads at most `MAX_STATEMENT_BYTES`. Raises EvidenceError."""
    with tempfile.TemporaryDirectory(prefix="rodeo-statement-") as folder:
        path = store.fetch(uri, proof_sha256, MAX_STATEMENT_BYTES, Path(folder))
        return read_statement(open_proof(path, STATEMENT_LIMITS))


def read_statement(proof: Proof) -> Statement:
    """The note and the photos in a proof, checked against each other. Raises NoStatement, CorruptProof."""
    said = [event for event in proof.events() if event.get("event") == "statement"]
    if len(said) != 1 or not isinstance(said[0].get("note"), str):
        raise NoStatement("the recording holds no statement", statements=len(said))
    column = proof.topics.get(PHOTO_TOPIC)
    messages = column.data if column is not None and column.ros_type == PHOTO_TYPE else []
    if len(messages) > MAX_PHOTOS or len(said[0]["note"]) > MAX_NOTE_CHARACTERS:
        raise NoStatement(
            "the statement is longer than one may be", photos=len(messages), characters=len(said[0]["note"])
        )
    try:
        photos = tuple(bytes(types.deserialize(data, PHOTO_TYPE).data) for data in messages)
    except MalformedMessage as error:
        raise NoStatement("a photo's message is not an image", cause=str(error)[:300]) from error
    digests = ["0x" + sha256(photo).hexdigest() for photo in photos]
    if said[0].get("photos_sha256") != digests:
        raise NoStatement("the photos do not match the statement", photos=len(photos))
    return Statement(said[0]["note"], photos)


def photo_cdr(photo: bytes, name: str, now_ns: int) -> bytes:
    """The message on `PHOTO_TOPIC`; `name` is the photo's format."""
    header = types.new("std_msgs/msg/Header", stamp=types.time_message(now_ns), frame_id="statement")
    image = types.new(PHOTO_TYPE, header=header, format=name, data=np.frombuffer(photo, np.uint8))
    return types.serialize(image)
