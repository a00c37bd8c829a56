"""A third-party bin. Run it instead of itrash: python my_bin.py --site FILE [--bin NAME]"""

import base64
import hashlib
import queue
import sys
from collections import deque

from rodeo.dao import ORGANIZATION, Participant
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.runtime.process import Process, main_of_one
from rodeo.site import topics
from rodeo.site.names import bin_process
from rodeo.site.tls import bus_is_closed
from rodeo.vision.classification import UNKNOWN
from rodeo.vision.classifier import Classifier
from rodeo.witness.roots import DailyRoots
from rodeo.witness.statement import Claimant, Classification, Drop, Presentation, Removal
from rodeo.witness.witness import Witness


class MyBin:
    inputs = None  # "sensor", where the sensors are wired to this machine

    def __init__(self, process, name):
        site, self.process, self.bin = process.site, process, process.site.bin(name)
        self.todo, self.classifier = queue.SimpleQueue(), Classifier()  # one thread does all, in order
        self.claimants, self.pictures, self.last = {}, {}, {}
        self.awaited, self.looked, self.view, self.seen_s = None, False, deque(maxlen=5), 0.0
        self.loads, self.weight = {one: deque(maxlen=10) for one in self.bin.compartments}, {}
        key, time = process.wait_account(f"{name}-device"), process.clock.now_ns
        inputs = self.inputs or ("closed_bus" if bus_is_closed(site) else "open_bus")
        self.witness = Witness(process.bus, site.org, name, key, process.data_dir, inputs, time, self.heard)
        DailyRoots(site, Participant(process.bus, site.org, ORGANIZATION), self.witness)
        process.bus.serve(topics.BIN_STATE.name(org=site.org, bin=name), lambda _: self.last)
        process.bus.serve(topics.BIN_PICTURE.name(org=site.org, bin=name), self.picture)
        self.open_sensors()

    def open_sensors(self):
        name, process = self.bin.name, self.process
        node = Node(process.bus.session, name, "", process.site.bus.domain_id, process.clock)
        self.trigger = node.client(topics.BIN_CAPTURE.name(bin=name), topics.BIN_CAPTURE.type)
        self.on(node, topics.BIN_PRESENCE, self.seen)
        self.on(node, topics.BIN_IMAGE, self.pictured)
        for one in self.bin.compartments:
            self.on(node, topics.BIN_LOAD, lambda m, t, one=one: self.weighed(one, m.wrench.force.z, t), one)

    def missing(self):
        if self.witness.chain is None or len(self.weight) < len(self.loads):
            return "the bridge and the load cells"
        return ""

    def on(self, node, topic, do, compartment=""):  # `do` gets each message with its stamp in s of site time
        def queued(message, _info):
            stamp_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
            self.todo.put(lambda: do(message, stamp_s))

        node.subscription(topic.name(bin=self.bin.name, compartment=compartment), topic.type, queued)

    def heard(self, device, said):  # a statement of another device, its signature checked
        if isinstance(said, Presentation) and said.bin == self.bin.name and device.role == "robot":
            who = {field: getattr(said, field) for field in ("recording", "task_id", "attempt")}
            newest = {device.name: Claimant(device=device.name, address=device.address, **who)}
            self.claimants.pop(device.name, None)
            self.claimants = newest | self.claimants

    def seen(self, message, time_s):  # presence sensor: photograph an item once it is held still
        if message.range > self.bin.presence_range_m:
            self.view.clear()
            self.looked = self.looked and time_s - self.seen_s < 1.0
            return
        self.view.append(message.range)
        self.seen_s = time_s
        if len(self.view) == 5 and max(self.view) - min(self.view) < 0.015 and not self.looked:
            self.looked = True
            self.trigger.call(types.new("std_srvs/srv/Trigger_Request"), timeout_s=10.0)

    def pictured(self, message, time_s):
        data, found = message.data.tobytes(), self.classifier.classify(message.data.tobytes())
        if found.label == UNKNOWN:  # look again
            self.looked = False
            return self.view.clear()
        name = "0x" + hashlib.sha256(data).hexdigest()
        self.pictures[name], where = data, self.bin.compartment_for(found.label, found.told)
        said = {"item_class": found.label, "probabilities": found.told, "image_sha256": name}
        used = {one: getattr(self.classifier, one) for one in ("model_sha256", "thresholds_sha256")}
        said |= used | {"compartment": where, "full": self.weight[where][0] > self.bin.full_at_n}
        said |= {"shown_s": time_s}
        claimants = tuple(self.claimants.values())[:8]
        self.awaited = self.sign(Classification, "classification", claimants=claimants, **said)

    def weighed(self, compartment, force_n, time_s):  # a settled change is a drop or a removal
        window = self.loads[compartment]
        window.append((time_s, force_n))
        forces = [force for _, force in window]
        if len(forces) < 10 or max(forces) - min(forces) > 0.05:
            return
        now_n, (old_n, after_s) = sum(forces) / 10, self.weight.get(compartment, (forces[0], time_s))
        changed = abs(now_n - old_n) >= 0.1
        self.weight[compartment] = now_n if changed else old_n, time_s
        said = {"compartment": compartment, "after_s": after_s, "settled_s": window[0][0]}
        if changed and now_n < old_n:
            self.sign(Removal, None, weight_n=old_n - now_n, **said)
        elif changed:
            shown, self.awaited = self.awaited or {}, None
            said |= {"classification": shown.get("number"), "expected_compartment": shown.get("compartment")}
            said |= {"weight_n": now_n - old_n, "correct": compartment == shown.get("compartment")}
            self.sign(Drop, "disposal", claimants=shown.get("claimants", ()), **said)

    def sign(self, model, kept_as, **said):
        chain = self.witness.chain
        if kept_as:  # the statement's own number, which a restart does not begin anew
            said["number"] = 1 + max((one.payload["seq"] for one in chain.last(1)), default=0)
        signed = chain.sign(model, self.process.clock.now_s(), **said)
        self.last = self.last | ({kept_as: signed.model_dump()} if kept_as else {})
        self.witness.publish(signed)
        return signed.payload

    def picture(self, request):
        wanted = request.parameters["sha256"]
        return {"sha256": wanted, "data_base64": base64.b64encode(self.pictures[wanted]).decode()}


def run(site, name, stop, make=MyBin):
    with Process(bin_process(site, name), site, stop) as process:
        process.wait_clock()
        mine = make(process, name)
        while not stop.is_set():
            if missing := mine.missing():
                process.not_ready(f"waiting for {missing}")
            else:
                process.ready()
            try:
                mine.todo.get(timeout=0.5)()
            except queue.Empty:
                continue


def names(site):
    return [one.name for one in site.bins]


if __name__ == "__main__":
    sys.exit(main_of_one("itrash", "bin", names, bin_process, run, "A third-party bin."))
