"""The site's own certificate authority: `python -m deploy.certificates --site FILE`.

Makes what is missing in `<data_dir>/tls/`: the authority, and a certificate for each process, each robot's
body ("body.<robot>") and the command line ("operator"). A process or robot on another machine needs `ca.pem`
and its own two files, nothing else; `ca.key` stays where it was made.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from deploy.access import everybody
from deploy.authority import issue, make_authority
from rodeo.site import tls
from rodeo.site.config import Site


def ensure_certificates(site: Site) -> list[str]:
    """Make what is missing; returns the names that got a certificate.

    Without the authority's private key nothing is made: then this is a machine that was given its files.
    """
    authority = tls.files(site, "ca")
    if not authority.authority.exists():
        make_authority(authority, f"{site.org} site authority")
    if not authority.key.exists():
        return []
    made = [name for name in everybody(site) if not tls.files(site, name).certificate.exists()]
    for name in made:
        _issue(site, name, authority)
    return made


def _issue(site: Site, name: str, authority: tls.Identity) -> None:
    router = name == "router"
    hosts = [site.bus.router.removeprefix("tls/").rpartition(":")[0].strip("[]")] if router else []
    issue(tls.files(site, name), name, authority, listens=router, hosts=hosts)


def report(folder: Path, made: list[str]) -> str:
    """A sentence that lists the files made in `folder`."""
    if not made:
        return f"{folder} already holds every certificate of this site."
    return f"Generated in {folder}: {', '.join(made)}."


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="certificates", description=__doc__)
    parser.add_argument("--site", type=Path, required=True, help="site file (TOML)")
    loaded = Site.load(parser.parse_args().site)
    print(report(tls.files(loaded, "ca").authority.parent, ensure_certificates(loaded)))
