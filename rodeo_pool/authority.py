"""A pool's own certificate authority: whoever has one of its certificates may run code on all its machines.

A folder holds `ca.pem`, and a certificate with its key for each role. A worker's machine needs `ca.pem`,
`worker.pem` and `worker.key`; `ca.key` stays where it was made. A site's certificates are of another
authority, so a pool refuses them.
"""

from __future__ import annotations

import ssl
from pathlib import Path
from typing import Literal, get_args

from distributed import Security

from deploy.authority import issue, make_authority
from rodeo.site.tls import Identity
from rodeo_pool.errors import PoolFilesDamaged, PoolFilesMissing

Role = Literal["client", "scheduler", "worker"]


def ensure(folder: Path) -> None:
    """Make what is missing in `folder`; nothing where the authority's private key is not. Raises
    PoolFilesDamaged."""
    authority = Identity.within(folder, "ca")
    try:
        if not authority.authority.exists():
            make_authority(authority, "pool authority")
    except OSError as error:
        raise PoolFilesDamaged(
            "the pool's certificates cannot be made there", folder=str(folder), reason=str(error)
        ) from error
    if not authority.key.exists():
        return
    for role in get_args(Role):
        files = Identity.within(folder, role)
        if not files.certificate.exists():
            # Workers listen, too: the scheduler and other workers connect to them.
            issue(files, role, authority, listens=role != "client")


def security(folder: Path, role: Role) -> Security:
    """What a party of that role shows and asks for. Raises PoolFilesMissing, PoolFilesDamaged."""
    files = Identity.within(folder.absolute(), role)
    for path in (files.authority, files.certificate, files.key):
        if not path.exists():
            raise PoolFilesMissing(
                "a file of the pool is missing: `rodeo pool start` makes it, copy it from there",
                path=str(path),
            )
    try:
        ssl.create_default_context(cafile=files.authority).load_cert_chain(files.certificate, files.key)
    except OSError as error:
        raise PoolFilesDamaged(
            "the pool's certificates cannot be read, or are not made for each other: copy them again",
            folder=str(files.authority.parent),
            role=role,
            reason=str(error),
        ) from error
    shown = {f"tls_{role}_cert": str(files.certificate), f"tls_{role}_key": str(files.key)}
    return Security(
        require_encryption=True,
        tls_ca_file=str(files.authority),
        tls_min_version=ssl.TLSVersion.TLSv1_3,
        **shown,
    )
