"""The bin as a process: sensors in, attestations out.

Sensor callbacks only feed the state machine. What takes time (photo, classification, signing, disk) is done
by the main thread, in the order in which it was asked for.
"""

from __future__ import annotations

import base64
import logging
import math
import queue
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from rodeo.bus import queries
from rodeo.bus.session import Request
from rodeo.dao import ORGANIZATION, Participant
from rodeo.errors import RodeoError
from rodeo.host.http import HttpServer
from rodeo.host.stamps import stamp_s
from rodeo.lab.config import BinConfig
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.node import Node
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site import topics
from rodeo.site.config import Site, bin_process
from rodeo.site.tls import bus_is_closed
from rodeo.vision.classification import UNKNOWN
from rodeo.vision.classifier import Classifier
from rodeo.witness import correction
from rodeo.witness.chain import Inputs
from rodeo.witness.devices import Device
from rodeo.witness.roots import DailyRoots
from rodeo.witness.statement import (
    Claimant,
    Classification,
    Drop,
    Header,
    Presentation,
    Removal,
    Statement,
    Watch,
)
from rodeo.witness.witness import Witness
from services.itrash.behaviour import (
    Action,
    Attest,
    Bin,
    ClassificationRecord,
    DropRecord,
    Record,
    State,
    TakePhoto,
    WatchRecord,
)
from services.itrash.camera import open_camera
from services.itrash.corrections import Corrections, NotYetKnown, pictures_of, read_correction
from services.itrash.journal import Journal, Kind
from services.itrash.pictures import NoSuchPicture, Pictures
from services.itrash.web import LIMITS, make_api

log = logging.getLogger(__name__)

_TELL_S = 0.5
"""Wall time between two looks at what is missing."""
_READING_S = 0.1
"""Site time between two looks while the bin is attentive: its sensors publish at 10 Hz
(rodeo.site.topics)."""
_SILENCE_S = 3.0
"""Wall time without a reading after which a sensor counts as missing."""
_NOT_LOGGED = {"probabilities", "image_sha256", "earlier", "model_sha256", "thresholds_sha256"}


class Itrash:
    """One bin."""

    def __init__(self, process: Process, config: BinConfig, classifier: Classifier) -> None:
        site = process.site
        self.classifier = classifier
        self._process = process
        self._config = config
        self._account = process.wait_account(f"{config.name}-device")
        self._path = process.data_dir / "journal.json"
        self._journal = Journal.load(self._path)
        self._bin = Bin(config, self._journal.memory)
        self._lock = threading.Lock()
        """Guards the state machine and the journal."""
        self._actions: queue.SimpleQueue[Action | None] = queue.SimpleQueue()
        for record in self._journal.memory.unsigned:  # decided before the process ended
            self._actions.put(Attest(record))
        self._waiting: list[Record] = []
        """Decided before the organization was known."""
        self._pictures = Pictures(process.data_dir / "pictures")
        self._corrections = Corrections(process.data_dir / "corrections", config.name)
        # Its sensors publish over the bus: on an open bus anybody may publish such readings.
        inputs: Inputs = "closed_bus" if bus_is_closed(site) else "open_bus"
        self._witness = Witness(
            process.bus,
            site.org,
            config.name,
            self._account,
            process.data_dir,
            inputs,
            process.clock.now_ns,
            self._on_statement,
        )
        self._roots = DailyRoots(site, Participant(process.bus, site.org, ORGANIZATION), self._witness)
        self._heard_s: dict[str, float] = {}
        """Wall (monotonic) time of each sensor's last reading."""
        node = Node(process.bus.session, config.name, "", site.bus.domain_id, process.clock)
        self.url = ""
        """Where the HTTP interface listens; set once it does."""
        self._camera = open_camera(config.camera, node, config.name, process.clock)
        presence, load = topics.BIN_PRESENCE, topics.BIN_LOAD
        self._sensors = {presence.name(bin=config.name)}
        # In the receiving thread: when a simulated clock's mark is there, so is what was sensed before.
        node.subscription(presence.name(bin=config.name), presence.type, self._on_presence, inline=True)
        for compartment in config.compartments:
            name = load.name(bin=config.name, compartment=compartment)
            self._sensors.add(name)
            node.subscription(name, load.type, self._load_callback(compartment, name), inline=True)
        self._node = node
        state_key = topics.BIN_STATE.name(org=site.org, bin=config.name)
        self._queryable = process.bus.serve(state_key, self._serve_state)
        picture_key = topics.BIN_PICTURE.name(org=site.org, bin=config.name)
        self._gallery = process.bus.serve(picture_key, self._serve_picture)
        corrections_key = topics.BIN_CORRECTIONS.name(org=site.org, bin=config.name)
        self._school = process.bus.serve(corrections_key, self._serve_corrections)

    # -- who shows something ---------------------------------------------------------------------------

    def _on_statement(self, device: Device, statement: Statement) -> None:
        """A registered device stated something; a robot may have presented itself."""
        if not isinstance(statement, Presentation) or statement.bin != self._config.name:
            return
        if device.role != "robot":
            log.warning("ignored a presentation by %s, which is not a robot", device.name)
            return
        claimant = Claimant(
            device=device.name,
            address=device.address,
            recording=statement.recording,
            task_id=statement.task_id,
            attempt=statement.attempt,
        )
        now_s = self._process.clock.now_s()
        with self._lock:
            self._bin.showing.presented(claimant, now_s, statement.grasped_s)
        log.info("%s presents itself for task %d", device.name, statement.task_id)

    # -- sensors ---------------------------------------------------------------------------------------

    def _on_presence(self, message: Any, _info: MessageInfo) -> None:
        if math.isnan(message.range):  # REP 117: an erroneous reading says nothing, not even "empty"
            return
        self._feed(
            topics.BIN_PRESENCE.name(bin=self._config.name),
            lambda: self._bin.presence(float(message.range), stamp_s(message.header.stamp)),
        )

    def _load_callback(self, compartment: str, sensor: str) -> Callable[[Any, MessageInfo], None]:
        def on_load(message: Any, _info: MessageInfo) -> None:
            force_n = float(message.wrench.force.z)
            if math.isfinite(force_n):  # a broken cell weighs nothing
                self._feed(
                    sensor, lambda: self._bin.load(compartment, force_n, stamp_s(message.header.stamp))
                )

        return on_load

    def _feed(self, sensor: str, step: Callable[[], list[Action]]) -> None:
        with self._lock:
            self._heard_s[sensor] = time.monotonic()
            before = self._remembered()
            actions = step()
            changed = self._remembered() != before
        for action in actions:
            self._actions.put(action)
        if changed and not actions:
            self._actions.put(None)  # nothing to do but to remember
        if changed or actions:
            self._process.clock.notify()

    def _remembered(self) -> tuple[Any, ...]:
        bin_, memory = self._bin, self._bin.memory
        # A caller that waits at rest has to see each reading once the next one may decide.
        watch = bin_.attentive, bin_.decides
        return memory.state, memory.since_s, memory.pending, *watch, tuple(bin_.loads_n.values())

    # -- actions ---------------------------------------------------------------------------------------

    def run(self) -> None:
        """Carry out actions until the process is asked to stop."""
        with self._process.clock.acting():
            self._live()

    def _live(self) -> None:
        try:
            while not self._process.stop.is_set():
                self._update_status()
                if self._waiting and self._witness.chain is not None:
                    waiting, self._waiting = self._waiting, []
                    for record in waiting:
                        self._attest(record)
                if self._await_action():
                    self._carry_out(self._actions.get())
        finally:
            self._roots.close()
            self._witness.close()
            self._camera.close()
            self._node.close()
            with self._lock:
                self._journal.save(self._path)

    def _await_action(self) -> bool:
        """Whether there is one before the next report is due. While something is shown or falls, each reading
        may be the one that decides: a simulated clock waits after it. A simulator that skips a charge
        continues to show readings, also while something is awaited."""
        attentive, decides = self._bin.attentive, self._bin.decides
        self._process.clock.wait_for(
            lambda: not self._actions.empty(),
            self._process.stop,
            wall_s=_TELL_S,
            every_s=_READING_S if decides else math.inf,
            resting=not attentive,
        )
        return not self._actions.empty() and not self._process.stop.is_set()

    def _remember(self) -> None:
        def save() -> None:
            with self._lock:
                self._journal.save(self._path)

        self._process.with_room(save)

    def _carry_out(self, action: Action | None) -> None:
        if isinstance(action, TakePhoto):
            self._look(action)
        elif isinstance(action, Attest):
            self._attest(action.record)
        else:
            self._remember()

    def _look(self, request: TakePhoto) -> None:
        self._update_status()
        try:
            time_s, data = self._camera.capture(request.after_s)
            classification = self.classifier.classify(data)
            image_sha256 = self._pictures.keep(data)
        except RodeoError as error:
            log.warning("no photo of the item: %s", error)
            failed_s = self._process.clock.now_s()
            self._feed("photo", lambda: self._bin.photo_failed(failed_s))
            return
        self._feed("photo", lambda: self._bin.photo(classification, image_sha256, time_s))

    def _attest(self, record: Record) -> None:
        chain = self._witness.chain
        if chain is None:
            self._waiting.append(record)
            return
        kind, model, fields = self._stated(record)
        attestation = self._process.with_room(
            lambda: chain.sign(model, self._process.clock.now_s(), **fields)
        )
        with self._lock:
            self._journal.add(kind, attestation)
            self._bin.memory.unsigned.remove(record)
        self._remember()  # before it is published: a restart would sign it again
        self._witness.publish(attestation)
        log.info("%s %s", kind, record.model_dump_json(exclude=_NOT_LOGGED))

    @staticmethod
    def _stated(record: Record) -> tuple[Kind, type[Header], dict[str, Any]]:
        """How a record is signed: its kind in the journal, the statement's model and its own fields."""
        fields = record.model_dump(by_alias=True)
        if isinstance(record, ClassificationRecord):
            return "classification", Classification, fields
        if isinstance(record, DropRecord):
            return "disposal", Drop, fields
        if isinstance(record, WatchRecord):
            return "watch", Watch, fields
        return "removal", Removal, fields

    # -- state -----------------------------------------------------------------------------------------

    def compartment_for(self, label: str, probabilities: Mapping[str, float]) -> str:
        """The site's compartment for this class."""
        return self._config.compartment_for(label, probabilities)

    def state(self) -> dict[str, Any]:
        """What the bin knows: state, weights (N), fill levels (1 is full), the last attestations."""
        with self._lock:
            pending = self._bin.memory.pending
            return {
                "bin": self._config.name,
                "state": self._bin.state.value,
                "since_s": self._bin.memory.since_s,
                "pending": None if pending is None else pending.number,
                "presented": [one.claimant.device for one in self._bin.memory.presented],
                "loads_n": self._bin.loads_n,
                "fill": {name: round(share, 3) for name, share in self._bin.fill.items()},
                "classification": _dump(self._journal.last("classification")),
                "disposal": _dump(self._journal.last("disposal")),
            }

    def events(self) -> list[dict[str, Any]]:
        """The last attestations, newest first."""
        with self._lock:
            return [entry.model_dump() for entry in reversed(self._journal.entries)]

    def missing_sensors(self) -> list[str]:
        """Sensors without a reading in the last seconds; the camera when it is known to be away."""
        now_s = time.monotonic()
        with self._lock:
            silent = sorted(s for s in self._sensors if now_s - self._heard_s.get(s, -math.inf) > _SILENCE_S)
        return silent if self._camera.problem() is None else ["camera", *silent]

    def image(self) -> bytes | None:
        """The camera's newest picture, encoded."""
        return self._camera.latest()

    def _serve_state(self, _request: Request) -> dict[str, Any]:
        return self.state()

    def _serve_picture(self, request: Request) -> dict[str, Any]:
        wanted = request.parameters.get("sha256", "")
        data = self._pictures.find(wanted)
        return {"sha256": wanted, "data_base64": base64.b64encode(data).decode()}

    def _serve_corrections(self, request: Request) -> dict[str, Any]:
        roles = queries.ask(self._process.bus, self._process.site.org, queries.ORGANIZATION).roles
        listed = roles.get("AUDITOR_ROLE", [])
        auditors = {one.address.lower(): one.name or one.address for one in listed}
        if request.payload:
            self._correct(request.payload, auditors)
        with self._lock:
            classified = self._journal.classified()
        found = correction.Corrections(
            bin=self._config.name,
            people=self._corrections.judged(auditors),
            pictures=tuple(
                correction.Pictured(
                    image_sha256=name,
                    item_class=said.payload["class"],
                    shown_s=said.payload["shown_s"],
                    corrections=self._corrections.said_of(name, auditors),
                )
                for name, said in classified.items()
                if self._pictures.has(name)
            ),
        )
        return found.model_dump(by_alias=True)

    def _correct(self, payload: bytes, auditors: Mapping[str, str]) -> None:
        chain = self._witness.chain
        if chain is None:
            raise NotYetKnown("the bin waits for the bridge to name the organization", bin=self._config.name)
        signed, said = read_correction(payload, chain.scope, self._config.name)
        with self._lock:
            classification = self._journal.classified().get(said.image_sha256)
        if classification is None:
            raise NoSuchPicture("the bin said nothing of such a picture lately", sha256=said.image_sha256)
        pictures = pictures_of(classification, self._pictures)
        classes = {*self.classifier.preprocessing.classes, UNKNOWN}
        self._corrections.add(signed, said, classification, pictures, classes, auditors)
        log.info("%s says that it was %s", auditors[signed.signer.lower()], said.item_class)

    def _update_status(self) -> None:
        """Put readiness and activity into the process's status."""
        missing = self.missing_sensors()
        if self._witness.chain is None:
            self._process.not_ready("waiting for the bridge to name the organization")
        elif missing:
            self._process.not_ready(f"no readings from {', '.join(missing)}")
        else:
            self._process.ready()
        with self._lock:
            pending, state = self._bin.memory.pending, self._bin.state
        text = state.value.replace("_", " ")
        if state is State.AWAITING_DROP and pending is not None:
            text = f"{pending.item_class}: waiting for it in {pending.compartment}"
        self._process.activity(text, http=self.url)


def _dump(model: Any) -> dict[str, Any] | None:
    return None if model is None else model.model_dump()


def run(site: Site, bin_name: str, stop: threading.Event) -> None:
    """The process of the bin called `bin_name`, until `stop`. Raises ConfigError for an unknown name."""
    config, name = site.bin(bin_name), bin_process(site, bin_name)
    with Process(name, site, stop) as process:
        process.serve_alone(served_by(site, name))
        process.wait_clock()
        bin_ = Itrash(process, config, Classifier())
        told = f"the page of {bin_name} (bins.http_port)"
        with HttpServer(make_api(bin_), config.http_host, config.http_port, told, LIMITS) as server:
            bin_.url = server.url
            log.info("HTTP on %s", server.url)
            bin_.run()
