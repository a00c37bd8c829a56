"""Processes that cannot start as they should, and sites that are not what somebody takes them for."""

from __future__ import annotations

import json
import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import closing, suppress
from urllib.parse import urlsplit

from bench.cpu import cpu_s
from bench.faults.case import BASE, case
from bench.faults.lab import Lab, need
from bench.faults.net import Answer, NodeBetween
from rodeo.host.instance import GAVE_UP
from tests.support.site import free_port

ITEM = """[[items]]
id = "item1"
class = "metal"
shape = "{shape}"
pose = {{ x_m = {x_m}, y_m = 1.2 }}
mass_kg = 0.03
"""


@case("the bridge's passphrase is wrong", said=r"passphrase", asks=False)
def wrong_passphrase(lab: Lab) -> Iterator[None]:
    path = lab.data / "keys" / "passphrase"
    right = path.read_text()
    lab.down("bridge")
    path.write_text("not this one\n")
    lab.up("bridge")
    yield
    need(lab.starts("bridge") <= 1, f"the bridge was started {lab.starts('bridge')} times")
    path.write_text(right)
    lab.restart_if_down("bridge")
    yield


@case("a keystore that the bridge needs is cut", said=r"keystore|oracle\.json", asks=False)
def keystore_cut(lab: Lab) -> Iterator[None]:
    path = lab.data / "keys" / "oracle.json"
    right = path.read_text()
    lab.down("bridge")
    path.write_text(right[:100])
    lab.up("bridge")
    yield
    path.write_text(right)
    lab.restart_if_down("bridge")
    yield


@case(
    "a keystore that only the motion capture needs is cut: the rest comes up",
    asks=False,
    said=r"mocap|keystore",
)
def keystore_of_a_device_cut(lab: Lab) -> Iterator[None]:
    path = lab.data / "keys" / "mocap-device.json"
    right = path.read_text()
    path.write_text(right[:100])
    lab.down("bridge", "chain")
    lab.up("chain", "bridge")
    lab.say(lab.rodeo("site", "prepare", "--site", str(lab.path)))
    lab.say(lab.program("deploy.contracts", "--site", str(lab.path))[1])
    lab.wait(lab.all_ready, "one unreadable keystore ends what does not need it")
    yield
    path.write_text(right)
    yield


@case("another program holds the chain's port", said=r"cannot listen|address already in use", asks=False)
def port_taken(lab: Lab) -> Iterator[None]:
    lab.down("chain")
    port = int(urlsplit(lab.site.chain.url).port or 0)
    listener = socket.create_server(("127.0.0.1", port))
    with closing(listener):
        lab.up("chain")
        lab.wait_said(r"cannot listen|address already in use")
        shown = lab.rodeo("status", "--site", str(lab.path))
        lab.say(shown)
        (row,) = [line for line in shown.splitlines() if line.startswith("chain")]
        need("cannot listen" in row or "in use" in row, f"the status does not say why: {row}")
        yield
    lab.restart_if_down("chain")
    yield


@case("a chain of another id answers on the node's port", said=r"4242", works=False, asks=False)
def other_chain_on_the_port(lab: Lab) -> Iterator[None]:
    def other(method: str, params: object, answer: Answer) -> object:
        return hex(4242) if method == "eth_chainId" else answer(method, params)  # type: ignore[arg-type]

    between = lab.enter(NodeBetween(lab.site.chain.url))
    lab.sites["bridge"] = lab.variant(
        "between", f'chain.url = "{between.url}"\nchain.websocket_url = ""\n', data=False
    )
    lab.start()
    between.fault = other
    lab.kill("bridge")
    lab.wait_said(r"4242")
    said = lab.said()
    need("31337" in said, "the id that the site expects is not said")
    need("run python -m deploy.contracts" not in said, "it asks to deploy on the stranger's chain")
    status, output = lab.program("deploy.contracts", "--site", str(lab.sites["bridge"]))
    need(status != 0 and "4242" in output, f"deployed on a stranger's chain: {output[-300:]}")
    yield
    between.fault = None
    yield


@case(
    "contracts are to be deployed and no node answers: it is said at once", said=r"127\.0\.0\.1", asks=False
)
def no_node_to_deploy_on(lab: Lab) -> Iterator[None]:
    wrong = lab.variant("nowhere", f'chain.url = "http://127.0.0.1:{free_port()}"\n')
    _status, output = lab.program("deploy.contracts", "--site", str(wrong))
    need("waiting for the node" in output, f"it does not say for what it waits: {output[-200:]}")
    lab.say(output)
    yield
    yield


@case(
    "a command is given for a site that does not run, while another runs on its router",
    said=r"another|whose|not this site|belongs",
    asks=False,
)
def other_sites_bus(lab: Lab) -> Iterator[None]:
    other = lab.variant("other", f'org = "other"\nbus.router = {json.dumps(lab.site.bus.router)}\n')
    # The same name, and contracts of its own.
    same_name = lab.variant("same", f"bus.router = {json.dumps(lab.site.bus.router)}\n")
    (record,) = (lab.folder / "same" / "deployments").glob("*.json")
    contracts = json.loads(record.read_text())
    contracts["contracts"]["Organization"] = contracts["contracts"]["TaskManager"]
    record.write_text(json.dumps(contracts))
    for site in (other, same_name):
        output = lab.rodeo(
            "task",
            "create",
            "waste_disposal",
            "--item-id",
            "item1",
            "--reward",
            "10",
            "--site",
            str(site),
        )
        lab.say(output)
    need(lab.client().tasks.count() == 1, "a task was posted into another organization's site")
    yield
    yield


@case("a misspelt variable of the environment", said=r"is RODEO__CHAIN(__URL)? meant", asks=False)
def misspelt_variable(lab: Lab) -> Iterator[None]:
    status, output = lab.program(
        "rodeo_cli", "status", "--site", str(lab.path), env={"RODEO__CHIAN__URL": "http://127.0.0.1:1"}
    )
    need(status != 0, "it was ignored")
    lab.say(output)
    yield
    yield


@case("an item's shape is unknown", said=r"shape|banana", asks=False)
def unknown_shape(lab: Lab) -> Iterator[None]:
    items = ITEM.format(shape="banana", x_m=4.6)
    wrong = lab.variant("wrong", items, data=False)
    # No process ever starts with such a file.
    status, output = lab.program("services.robot_sim", "--site", str(wrong))
    need(status == GAVE_UP, f"a restart would be tried: status {status}, {output[-200:]}")
    lab.say(output)
    yield
    yield


@case("an item lies 10 m outside the room", said=r"item1", asks=False)
def item_outside_the_room(lab: Lab) -> Iterator[None]:
    items = ITEM.format(shape="can", x_m=17.0)
    wrong = lab.variant("wrong", items, data=False)
    status, output = lab.program("rodeo_cli", "site", "check", str(wrong))
    need(status != 0 and "item1" in output, f"nothing was found: {output[-200:]}")
    lab.say(output)
    yield
    yield


# -- the console -------------------------------------------------------------------------------------------

CONSOLE = (*BASE, "console")


@case("the console's accounts are damaged", said=r"accounts\.sqlite", processes=CONSOLE)
def accounts_damaged(lab: Lab) -> Iterator[None]:
    path = lab.data / "console" / "accounts.sqlite"
    lab.down("console")
    whole = path.read_bytes() if path.exists() else b""
    path.write_bytes(b"no database" * 1000)
    lab.up("console")
    lab.wait_said(r"accounts\.sqlite")
    need("Traceback" not in lab.said(), "a traceback")
    yield
    path.unlink()
    if whole:
        path.write_bytes(whole)
    lab.restart_if_down("console")
    yield


@case("a login whose body claims an encoding that takes long", processes=CONSOLE)
def login_in_punycode(lab: Lab) -> Iterator[None]:
    url = f"http://127.0.0.1:{lab.site.console.port}/login"
    body = b"name=" + b"a" * 400_000
    request = urllib.request.Request(
        url, body, {"content-type": "application/x-www-form-urlencoded; charset=punycode"}
    )
    pid = lab.pid("console")
    before_s = cpu_s(pid)
    with suppress(urllib.error.URLError):  # refused, as it should be
        urllib.request.urlopen(request, timeout=60).read()
    spent_s = cpu_s(pid) - before_s
    need(spent_s < 2.0, f"it cost {spent_s:.0f} s of CPU")
    yield
    yield


@case(
    "another program holds the console's port",
    said=r"cannot listen|address already in use|in use",
    processes=CONSOLE,
)
def console_port_taken(lab: Lab) -> Iterator[None]:
    lab.down("console")
    with closing(socket.create_server(("127.0.0.1", lab.site.console.port))):
        lab.up("console")
        lab.wait_said(r"cannot listen|in use")
        yield
    lab.restart_if_down("console")
    yield
