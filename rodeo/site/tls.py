"""How closed a site's bus is, and who a process is on one that asks for certificates (`deploy.certificates`).

A site whose router's endpoint begins with `tls/` lets in only who shows a certificate of the site's own
authority; the router's access rules (`deploy.access`) follow the name in it. See `rodeo.site.endpoint`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rodeo.errors import ConfigError
from rodeo.site import endpoint
from rodeo.site.config import Site

OPERATOR = "operator"
"""Identity that is neither a process of the table nor a robot's body: the command line, the launcher."""


@dataclass(frozen=True)
class Identity:
    """PEM files: an authority, the certificate that it issued, and the private key of that."""

    authority: Path
    certificate: Path
    key: Path

    @classmethod
    def within(cls, folder: Path, name: str) -> Identity:
        """Where the files of `name` are, or would be; of `ca` those of the authority itself."""
        return cls(folder / "ca.pem", folder / f"{name}.pem", folder / f"{name}.key")

    def zenoh(self) -> dict[str, Any]:
        """Zenoh's `transport/link/tls`, for connecting and for listening."""
        certificate, key = str(self.certificate), str(self.key)
        return {
            "root_ca_certificate": str(self.authority),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "connect_certificate": certificate,
            "connect_private_key": key,
            "listen_certificate": certificate,
            "listen_private_key": key,
        }


def wants_certificates(site: Site) -> bool:
    """Whether the bus is one of certificates and access rules."""
    return endpoint.wants_certificates(site.bus.router)


def bus_is_closed(site: Site) -> bool:
    """Whether nobody but the site's own processes can speak on its bus: what is said there counts."""
    return not site.bus.open


def openness(site: Site) -> str:
    """What people read of a bus that is open; empty on a closed one."""
    if bus_is_closed(site):
        return ""
    return (
        f"the bus is open (bus.open = true): anybody who reaches {site.bus.router} can publish as any "
        "process, so the oracle decides no work there, a cleaning for example, and nobody is paid for it: "
        f"remove bus.open, and {endpoint.CLOSED_INSTEAD}"
    )


def files(site: Site, name: str) -> Identity:
    """Where the files of `name` are, or would be."""
    return Identity.within((site.data_dir / "tls").absolute(), name)


def identity(site: Site, name: str) -> Identity | None:
    """What `name` shows on the bus; None where none is asked for. Raises ConfigError if a file is missing."""
    if not wants_certificates(site):
        return None
    found = files(site, name)
    for path in (found.authority, found.certificate, found.key):
        if not path.exists():
            raise ConfigError("a file is missing: run python -m deploy.certificates", path=str(path))
    return found
