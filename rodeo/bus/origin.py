"""Owner of a bus: a command compares its site with what the processes there say of theirs."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path

import zenoh
from pydantic import ValidationError

from rodeo.bus.messages import Origin, Status
from rodeo.bus.session import Bus
from rodeo.errors import WrongBus
from rodeo.site import topics
from rodeo.site.config import Site

_ANSWER_S = 2.0
"""Wall time after which a process that hangs is not waited for."""


def record_path(data_dir: Path, chain_id: int) -> Path:
    """Where `rodeo.chain.Deployment` keeps which contracts the site has."""
    return data_dir / "deployments" / f"{chain_id}.json"


def origin_of(site: Site) -> Origin:
    """Identifies this site among others of the same name."""
    path = record_path(site.data_dir, site.chain.id)
    try:
        record = json.loads(path.read_bytes())
        contracts = f"{record['contracts']['Organization']} of chain {record['genesis_hash']}"
    except (OSError, ValueError, KeyError, TypeError):
        # Not deployed yet; code that needs the record reports what is wrong with it.
        contracts = ""
    return Origin(host=socket.gethostname(), data_dir=str(site.data_dir.resolve()), contracts=contracts)


def check_bus(bus: Bus, site: Site, *, strict: bool = True) -> None:
    """Raises WrongBus when the processes on `bus` are of another site.

    The same folder, or the same contracts, is the same site. `strict`: another folder of this machine without
    contracts to compare is another site, and so is a bus where only other organizations are. An empty bus is
    no error. A site on another machine is none either, unless its contracts differ.
    """
    ours = origin_of(site)
    strangers = []
    heard = False
    for _, status in statuses_at(bus, topics.STATUS.pattern(org=site.org)):
        theirs, heard = status.origin, True
        if theirs is None:
            continue
        here = theirs.host == ours.host
        if here and theirs.data_dir == ours.data_dir:
            return
        if ours.contracts and theirs.contracts:
            if ours.contracts == theirs.contracts:
                return
            strangers.append(theirs)
        elif here and strict:
            strangers.append(theirs)
    if strangers:
        raise _wrong(site, site.org, strangers[0])
    if heard or not strict:
        return
    for org, status in statuses_at(bus, topics.STATUS.pattern()):
        if org != site.org:
            raise _wrong(site, org, status.origin)


def statuses_at(bus: Bus, key: str, timeout_s: float = _ANSWER_S) -> Iterator[tuple[str, Status]]:
    """(organization, status) of each process that answers at `key` in `timeout_s` of wall time. There may be
    several of one name."""
    replies = bus.session.get(
        key,
        timeout=timeout_s,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    for reply in replies:
        if reply.ok is None:
            continue
        try:
            status = Status.model_validate_json(reply.ok.payload.to_bytes())
        except ValidationError:
            # Somebody else's answer on our key is not the status of a process.
            continue
        parts = topics.STATUS.parts(str(reply.ok.key_expr))
        if parts is not None and parts["process"] == status.process:
            yield parts["org"], status


def _wrong(site: Site, org: str, theirs: Origin | None) -> WrongBus:
    whose = f"the organization {org}"
    if theirs is not None:
        whose += f" in {theirs.data_dir} on {theirs.host}"
        whose += f", with the contracts {theirs.contracts}" if theirs.contracts else ""
    ours = f"{site.org} in {site.data_dir}"
    return WrongBus(
        f"the bus at {site.bus.router} belongs to {whose}, not to this site ({ours})",
        router=site.bus.router,
        org=org,
    )
