"""Disks that fill up."""

from __future__ import annotations

from collections.abc import Iterator

from bench.faults.case import BASE, case
from bench.faults.lab import Lab, need

FULL = r"no space left|disk is full|disk full|bytes (are )?left|free on"


def full(lab: Lab) -> Iterator[None]:
    """The end of a script: the small disk is full while the fault stands."""
    assert lab.disk is not None
    lab.disk.fill()
    yield
    lab.disk.free()
    yield


@case("the disk with the bridge's folder is full", said=FULL, small_disk="bridge", held_s=8.0)
def disk_full_bridge(lab: Lab) -> Iterator[None]:
    yield from full(lab)
    need(lab.post("meanwhile") == lab.asked["meanwhile"], "the same request_id made another task")


@case("the disk with the embedded chain's folder is full", said=FULL, small_disk="chain", held_s=8.0)
def disk_full_chain(lab: Lab) -> Iterator[None]:
    yield from full(lab)


@case("the disk with all data and logs of the site is full", said=FULL, small_disk=".", held_s=8.0)
def disk_full_everything(lab: Lab) -> Iterator[None]:
    assert lab.disk is not None
    lab.disk.fill()
    # Whoever cannot write says that it is not ready, and does not loop.
    lab.wait(lambda: not lab.ready("bridge"), "the bridge says ready on a full disk")
    before = [lab.pid(name) for name in lab.case.processes]
    yield
    need([lab.pid(name) for name in lab.case.processes] == before, "a process ended and was started again")
    lab.disk.free()
    yield


@case(
    "the disk with the store of proofs is full",
    said=FULL,
    small_disk="store",
    held_s=5.0,
    processes=(*BASE, "oracle"),
    asks=False,
)
def disk_full_store(lab: Lab) -> Iterator[None]:
    """The oracle cannot put its report: the verdict waits."""
    label = "meanwhile"
    lab.post(label)
    sha256, uri = lab.store(b"no recording: meanwhile")
    assert lab.disk is not None
    lab.disk.fill()
    lab.submit(label, sha256, uri)
    yield
    lab.disk.free()
    yield
    task = lab.wait_ended(label)
    need(task["state"] == "failed", f"task {task['id']} is {task['state']}")
