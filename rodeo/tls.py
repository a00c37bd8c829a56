"""Who a process is on a bus that is closed to strangers: its certificate, made by `deploy.certificates`.

A site whose router's endpoint begins with `tls/` lets in only who shows a certificate of the site's own
authority; the router's access rules (`deploy.access`) follow the name in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rodeo.config import Site
from rodeo.errors import ConfigError

OPERATOR = "operator"
"""The name of whoever is not a process of the table: the command line, the launcher."""


@dataclass(frozen=True)
class Identity:
    """PEM files: the site's authority, this process's certificate and its private key."""

    authority: Path
    certificate: Path
    key: Path

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


def is_closed(site: Site) -> bool:
    """Whether the bus wants certificates."""
    return site.bus.router.startswith("tls/")


def files(site: Site, name: str) -> Identity:
    """Where the files of `name` are, or would be."""
    folder = (site.data_dir / "tls").absolute()
    return Identity(folder / "ca.pem", folder / f"{name}.pem", folder / f"{name}.key")


def identity(site: Site, name: str) -> Identity | None:
    """What `name` shows on the bus; None on an open one. Raises ConfigError when a file is missing."""
    if not is_closed(site):
        return None
    found = files(site, name)
    for path in (found.authority, found.certificate, found.key):
        if not path.exists():
            raise ConfigError("a file is missing: run python -m deploy.certificates", path=str(path))
    return found
