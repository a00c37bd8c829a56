"""Networks that let nothing through for a while, and nodes that answer wrongly."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from typing import Any
from urllib.parse import urlsplit

from bench.faults.case import BASE, Case, Script, add, case
from bench.faults.lab import Lab
from bench.faults.net import Answer, Fault, Link, NodeBetween
from deploy.chain.errors import InternalError
from rodeo_testing.waiting import HANG_S
from tests.support.site import free_port

NO_NODE = r"no node|node does not answer|blocks behind|it hangs|node refused"


def _cut_from_the_bus(process: str) -> Script:
    def script(lab: Lab) -> Iterator[None]:
        router = int(lab.site.bus.router.rpartition(":")[2])
        link = lab.enter(Link(router))
        lab.sites[process] = lab.variant("cut", f'bus.router = "tcp/127.0.0.1:{link.port}"\n', data=False)
        lab.start()
        link.cut()
        yield
        link.heal()
        yield

    return script


def _cut_from_the_node(lab: Lab) -> Iterator[None]:
    link = lab.enter(Link(int(urlsplit(lab.site.chain.url).port or 0)))
    lab.sites["bridge"] = lab.variant("cut", f'chain.url = "http://127.0.0.1:{link.port}"\n', data=False)
    lab.start()
    link.cut()
    yield
    link.heal()
    yield


for _process, _seconds in (("bridge", 10), ("bridge", 60), ("bridge", 300), ("oracle", 30)):
    add(
        Case(
            name=f"{_process}_cut_from_the_bus_{_seconds}_s",
            area="partitions",
            breaks=f"nothing gets through between the {_process} and the router for {_seconds} s",
            script=_cut_from_the_bus(_process),
            said=r"no router|does not answer|heartbeat stopped" if _seconds > 20 else "",
            processes=(*BASE, "oracle") if _process == "oracle" else BASE,
            extra=f'bus.router = "tcp/127.0.0.1:{free_port()}"\nbus.open = true\n',
            held_s=_seconds,
            works=False,
            waits=True,
        )
    )

for _seconds in (20, 120):
    add(
        Case(
            name=f"bridge_cut_from_the_node_{_seconds}_s",
            area="partitions",
            breaks=f"nothing gets through between the bridge and the node for {_seconds} s",
            script=_cut_from_the_node,
            said=NO_NODE,
            held_s=_seconds,
            works=False,
            waits=True,
        )
    )


# -- nodes that lie ----------------------------------------------------------------------------------------


def _bridge_asks(lab: Lab, between: NodeBetween) -> None:
    lab.sites["bridge"] = lab.variant(
        "between",
        f'chain.url = "{between.url}"\nchain.websocket_url = ""\nbridge.stuck_s = 2.0\n',
        data=False,
    )
    lab.start()


def _lying(lab: Lab, fault: Fault) -> Iterator[None]:
    between = lab.enter(NodeBetween(lab.site.chain.url))
    _bridge_asks(lab, between)
    between.fault = fault
    yield
    between.fault = None
    yield


@case("the node refuses everything with an error of its own", said=NO_NODE, works=False, held_s=4.0)
def node_refuses(lab: Lab) -> Iterator[None]:
    def refuse(_method: str, _params: Sequence[Any], _answer: Answer) -> Any:
        raise InternalError("out of order")

    yield from _lying(lab, refuse)


@case("the node takes transactions, says their hash and forgets them", works=False, held_s=6.0)
def node_forgets_transactions(lab: Lab) -> Iterator[None]:
    def forget(method: str, params: Sequence[Any], answer: Answer) -> Any:
        return "0x" + "ab" * 32 if method == "eth_sendRawTransaction" else answer(method, params)

    yield from _lying(lab, forget)


@case("the node sends transactions on, but says that it failed", works=False, held_s=4.0)
def node_denies_transactions(lab: Lab) -> Iterator[None]:
    def deny(method: str, params: Sequence[Any], answer: Answer) -> Any:
        result = answer(method, params)
        if method == "eth_sendRawTransaction":
            raise InternalError("something went wrong")
        return result

    yield from _lying(lab, deny)


@case("the node hangs at every question", said=NO_NODE, works=False, held_s=4.0)
def node_hangs(lab: Lab) -> Iterator[None]:
    goes_on = threading.Event()

    def hang(method: str, params: Sequence[Any], answer: Answer) -> Any:
        goes_on.wait(HANG_S)
        return answer(method, params)

    between = lab.enter(NodeBetween(lab.site.chain.url))
    _bridge_asks(lab, between)
    between.fault = hang
    yield
    between.fault = None
    goes_on.set()
    yield


@case(
    "the node leaves events out of its answers for a while",
    said=r"rebuil|made anew|does not agree|differ",
    works=False,
)
def node_hides_events(lab: Lab) -> Iterator[None]:
    hidden = threading.Event()

    def hide(method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == "eth_getLogs":
            found = answer(method, params)
            if found:
                hidden.set()
            return []
        return answer(method, params)

    between = lab.enter(NodeBetween(lab.site.chain.url))
    _bridge_asks(lab, between)
    between.fault = hide
    posted = lab.post_beside("hidden")
    lab.wait(hidden.is_set, "the bridge does not ask for the event")
    between.fault = None
    yield
    yield
    posted.result(timeout=HANG_S)
    lab.wait(
        lambda: posted.result() in [task["id"] for task in lab.state("tasks", limit=100)["tasks"]],
        "the index never heard of a task that is on the chain",
    )
    lab.finish("hidden")
