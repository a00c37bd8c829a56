"""The bin as a process: sensors in, attestations out.

Sensor callbacks only feed the state machine. What takes time (photo, classification, signing, disk) is done
by the main thread, in the order in which it was asked for.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from typing import Any

from rodeo.dao import ORGANIZATION, Participant
from rodeo.evidence.attestation import Attestation
from rodeo.host.http import HttpServer
from rodeo.lab.config import BinConfig
from rodeo.ros2.node import Node
from rodeo.runtime.process import Process, return_memory
from rodeo.runtime.serving import served_by
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.names import bin_process
from rodeo.site.tls import bus_is_closed
from rodeo.vision.classification import UNKNOWN
from rodeo.vision.classifier import Classifier
from rodeo.witness.chain import Inputs
from rodeo.witness.devices import Device
from rodeo.witness.roots import DailyRoots
from rodeo.witness.statement import Claimant, Presentation, Statement
from rodeo.witness.witness import Witness
from services.itrash.behaviour import Action, Attest, Bin, Record, State, TakePhoto
from services.itrash.camera import open_camera
from services.itrash.eye import Eye
from services.itrash.gallery import Gallery
from services.itrash.journal import Journal, stated
from services.itrash.pictures import Pictures
from services.itrash.steps import Steps
from services.itrash.web import LIMITS, make_api

log = logging.getLogger(__name__)

_NOT_LOGGED = {"probabilities", "image_sha256", "earlier", "model_sha256", "thresholds_sha256"}


class Itrash:
    """One bin."""

    def __init__(self, process: Process, config: BinConfig, classifier: Classifier) -> None:
        site, bus = process.site, process.bus
        self.classifier = classifier
        self._process = process
        self._config = config
        account = process.wait_account(f"{config.name}-device")
        self._path = process.data_dir / "journal.json"
        self._journal = Journal.load(self._path)
        self._bin = Bin(config, self._journal.memory)
        self._steps = Steps(self._bin, process)
        self._waiting: list[Record] = []
        """Decided before the organization was known."""
        # Its sensors publish over the bus: on an open bus anybody may publish such readings.
        inputs: Inputs = "closed_bus" if bus_is_closed(site) else "open_bus"
        clock = process.clock
        self._witness = Witness(
            bus, site.org, config.name, account, process.data_dir, inputs, clock.now_ns, self._on_statement
        )
        self._roots = DailyRoots(site, Participant(bus, site.org, ORGANIZATION), self._witness)
        self.url = ""
        """Where the HTTP interface listens; set once it does."""
        self._node = Node(bus.session, config.name, "", site.bus.domain_id, clock)
        pictures = Pictures(process.data_dir / "pictures")
        camera = open_camera(config.camera, self._node, config.name, clock)
        self._eye = Eye(camera, classifier, pictures, clock)
        self._sensors = self._steps.listen(self._node, config)
        classes = frozenset({*classifier.preprocessing.classes, UNKNOWN})
        self._served = [
            bus.serve(topics.BIN_STATE.name(org=site.org, bin=config.name), lambda _request: self.state()),
            Gallery(process, config.name, pictures, self._classified, self._witness, classes),
        ]

    def _classified(self) -> dict[str, Attestation]:
        with self._steps.lock:
            return self._journal.classified()

    def _on_statement(self, device: Device, statement: Statement) -> None:
        """A registered device stated something; a robot may have presented itself."""
        now_s = self._process.clock.now_s()
        with self._steps.lock:
            present(self._bin, self._config.name, device, statement, now_s)

    def run(self) -> None:
        """Carry out actions until the process is asked to stop."""
        try:
            self._steps.arrived.loop(self._process.stop, self._look)
        finally:
            self._roots.close()
            self._witness.close()
            self._eye.camera.close()
            self._node.close()
            self._save()

    def _look(self) -> None:
        self._update_status()
        if self._waiting and self._witness.chain is not None:
            waiting, self._waiting = self._waiting, []
            for record in waiting:
                self._attest(record)
        if self._steps.await_action():
            self._carry_out(self._steps.next())

    def _save(self) -> None:
        with self._steps.lock:
            self._journal.save(self._path)

    def _carry_out(self, action: Action | None) -> None:
        if isinstance(action, TakePhoto):
            self._update_status()
            self._eye.look(action, self._steps)
        elif isinstance(action, Attest):
            self._attest(action.record)
        else:
            self._process.disk.with_room(self._save)

    def _attest(self, record: Record) -> None:
        chain = self._witness.chain
        if chain is None:
            self._waiting.append(record)
            return
        kind, model, fields = stated(record)
        attestation = self._process.disk.with_room(
            lambda: chain.sign(model, self._process.clock.now_s(), **fields)
        )
        with self._steps.lock:
            self._journal.add(kind, attestation)
            self._bin.memory.unsigned.remove(record)
        self._process.disk.with_room(self._save)  # before it is published: a restart would sign it again
        self._witness.publish(attestation)
        log.info("%s %s", kind, record.model_dump_json(exclude=_NOT_LOGGED))

    def compartment_for(self, label: str, probabilities: Mapping[str, float]) -> str:
        """The site's compartment for this class."""
        return self._config.compartment_for(label, probabilities)

    def state(self) -> dict[str, Any]:
        """What the bin knows: state, weights (N), fill levels (1 is full), the last attestations."""
        with self._steps.lock:
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
        with self._steps.lock:
            return [entry.model_dump() for entry in reversed(self._journal.entries)]

    def missing_sensors(self) -> list[str]:
        """Sensors without a reading in the last seconds; the camera when it is known to be away."""
        silent = self._steps.silent(self._sensors)
        return silent if self._eye.camera.problem() is None else ["camera", *silent]

    def image(self) -> bytes | None:
        """The camera's newest picture, encoded."""
        return self._eye.camera.latest()

    def _update_status(self) -> None:
        """Put readiness and activity into the process's status."""
        missing = self.missing_sensors()
        if self._witness.chain is None:
            self._process.not_ready("waiting for the bridge to name the organization")
        elif missing:
            self._process.not_ready(f"no readings from {', '.join(missing)}")
        else:
            self._process.ready()
        with self._steps.lock:
            pending, state = self._bin.memory.pending, self._bin.state
        text = state.value.replace("_", " ")
        if state is State.AWAITING_DROP and pending is not None:
            text = f"{pending.item_class}: waiting for it in {pending.compartment}"
        self._process.activity(text, http=self.url)


def present(bin_: Bin, name: str, device: Device, statement: Statement, now_s: float) -> None:
    """A robot that presents itself to the bin `name` is the claimant of what it shows next."""
    if not isinstance(statement, Presentation) or statement.bin != name:
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
    bin_.showing.presented(claimant, now_s, statement.grasped_s)
    log.info("%s presents itself for task %d", device.name, statement.task_id)


def _dump(model: Any) -> dict[str, Any] | None:
    return None if model is None else model.model_dump()


def run(site: Site, bin_name: str, stop: threading.Event) -> None:
    """The process of the bin called `bin_name`, until `stop`. Raises ConfigError for an unknown name."""
    config, name = site.bin(bin_name), bin_process(site, bin_name)
    with Process(name, site, stop) as process:
        process.serve_alone(served_by(site, name))
        process.wait_clock()
        return_memory()  # the network needs 40 MB while it is loaded, and 30 for each picture
        bin_ = Itrash(process, config, Classifier())
        told = f"the page of {bin_name} (bins.http_port)"
        with HttpServer(make_api(bin_), config.http_host, config.http_port, told, LIMITS) as server:
            bin_.url = server.url
            log.info("HTTP on %s", server.url)
            bin_.run()
