"""Processes that are killed, or hang."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from bench.faults.case import BASE, Case, Script, add
from bench.faults.lab import Lab

SILENT = r"no router|does not answer|no node|heartbeat stopped|it hangs"


def _killed(*names: str) -> Script:
    def script(lab: Lab) -> Iterator[None]:
        lab.kill(*names)
        yield
        yield

    return script


def _stopped(name: str) -> Script:
    """Ctrl-C for one process, which is started again a while later."""

    def script(lab: Lab) -> Iterator[None]:
        lab.down(name)
        yield
        lab.up(name)
        yield

    return script


for _names, _processes in (
    (("router",), BASE),
    (("chain",), BASE),
    (("bridge",), BASE),
    (("oracle",), (*BASE, "oracle")),
    (("chain", "bridge"), BASE),
    (BASE, BASE),
):
    add(
        Case(
            name="killed_" + ("everything" if _names == BASE else "_and_".join(_names)),
            area="stops",
            breaks=f"SIGKILL to {', '.join(_names)} at once",
            script=_killed(*_names),
            processes=_processes,
        )
    )

for _name, _processes in (("router", BASE), ("chain", BASE), ("bridge", BASE), ("oracle", (*BASE, "oracle"))):
    add(
        Case(
            name=f"frozen_{_name}",
            area="stops",
            breaks=f"the {_name} hangs (SIGSTOP) for 12 s",
            script=partial(Lab.frozen, name=_name),
            said=SILENT,
            processes=_processes,
            held_s=12.0,
            waits=True,
        )
    )

for _name in ("chain", "router"):
    add(
        Case(
            name=f"stopped_{_name}",
            area="stops",
            breaks=f"the {_name} is stopped for 6 s",
            script=_stopped(_name),
            said=SILENT,
            held_s=6.0,
        )
    )
