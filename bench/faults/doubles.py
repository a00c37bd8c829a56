"""A second one of what there may be once: the same key or device name, from another machine's folder."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import Future

from bench.faults.case import BASE, Case, Script, add, case
from bench.faults.lab import Lab, need
from rodeo_testing import BINS
from rodeo_testing.waiting import HANG_S

REFUSED = r"already served by|served_elsewhere"


@case("a second bridge with the same wallets, from another machine", said=REFUSED)
def second_bridge(lab: Lab) -> Iterator[None]:
    elsewhere = lab.variant("elsewhere", "")
    lab.up("bridge", site=elsewhere)
    # It has refused, or serves by now.
    lab.wait_for_log("elsewhere", "bridge", REFUSED + r"|: ready$")
    labels = [f"post {number}" for number in range(20)]
    posted: list[Future[int]] = [lab.post_beside(label) for label in labels]
    for one in posted:
        one.result(timeout=HANG_S)
    yield
    lab.down("bridge", site=elsewhere)
    need(len({one.result() for one in posted}) == len(labels), "two requests got one task")
    lab.wait(lambda: lab.ready("bridge"), "the first bridge is not ready")
    for label in labels:
        lab.cancel_if_open(label)
    yield


def _second(name: str) -> Script:
    def script(lab: Lab) -> Iterator[None]:
        elsewhere = lab.variant("elsewhere", f"console.port = 0\n{BINS}\n")
        lab.up(name, site=elsewhere)
        lab.wait_for_log("elsewhere", name, REFUSED)
        need(lab.ready(name), f"the first {name} is not ready")
        yield
        lab.down(name, site=elsewhere)
        yield

    return script


for _name, _processes in (
    ("oracle", (*BASE, "oracle")),
    ("console", (*BASE, "console")),
    ("itrash", (*BASE, "robot_sim", "itrash")),
    ("charger", (*BASE, "robot_sim", "charger")),
    ("robot_sim", (*BASE, "robot_sim")),
    ("robot_agent", (*BASE, "itrash", "robot_sim", "robot_agent")),
):
    add(
        Case(
            name=f"second_{_name}",
            area="doubles",
            breaks=f"a second {_name} with the same keys and names, from another machine",
            script=_second(_name),
            said=REFUSED,
            # A robot that works would do the task itself, at its own price.
            asks="robot_agent" not in _processes,
            processes=_processes,
            extra="" if "robot_sim" in _processes else 'clock.source = "wall"\n',
        )
    )


def _same_folder(name: str) -> Script:
    def script(lab: Lab) -> Iterator[None]:
        status, output = lab.program(f"services.{name}", "--site", str(lab.path))
        need(status != 0, f"a second {name} ran beside the first")
        lab.say(output)
        yield
        yield

    return script


for _name in ("bridge", "oracle"):
    add(
        Case(
            name=f"second_{_name}_same_folder",
            area="doubles",
            breaks=f"the {_name} is started twice on one data directory",
            script=_same_folder(_name),
            said=r"already running",
            processes=(*BASE, "oracle") if _name == "oracle" else BASE,
        )
    )


@case("two bridges that share the wallets between them: nothing is wrong", asks=False, works=False)
def two_bridges_two_wallets(lab: Lab) -> Iterator[None]:
    bridges = 'bridges = [{ name = "panther1", wallets = ["panther1"] }]\n'
    lab.sites["bridge"] = lab.variant("most", bridges, data=False)
    other = lab.variant("own", f"store.url = {json.dumps(lab.site.store_url)}\n{bridges}")
    lab.up("router", "chain")
    lab.up("bridge")
    lab.up("bridge.panther1", site=other)
    lab.start()
    yield
    yield
    lab.work("shared")
