"""The site's own certificate authority: `python -m deploy.certificates --site FILE`.

Makes what is missing in `<data_dir>/tls/`: the authority, and a certificate for each process, each robot's
body ("body.<robot>") and the command line ("operator"). A process or robot on another machine needs `ca.pem`
and its own two files, nothing else; `ca.key` stays where it was made.
"""

from __future__ import annotations

import argparse
import datetime
import ipaddress
import os
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from deploy.access import everybody
from rodeo.site import tls
from rodeo.site.config import Site

_AUTHORITY_DAYS = 3650
_CERTIFICATE_DAYS = 825
"""Longest validity of a private authority's certificate that browsers and Apple's platforms accept."""

_SKEW = datetime.timedelta(hours=1)
"""A new certificate is valid on machines whose clocks differ by less than this."""


def ensure_certificates(site: Site) -> list[str]:
    """Make what is missing; returns the names that got a certificate.

    Without the authority's private key nothing is made: then this is a machine that was given its files.
    """
    authority = tls.files(site, "ca")
    if not authority.authority.exists():
        _make_authority(authority, site.org)
    if not authority.key.exists():
        return []
    made = [name for name in everybody(site) if not tls.files(site, name).certificate.exists()]
    for name in made:
        _issue(site, name, authority)
    return made


def _make_authority(files: tls.Identity, org: str) -> None:
    files.authority.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"{org} site authority")
    certificate = (
        _builder(name, name, key.public_key(), _AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    _write(files.key, _pem(key))
    _write(files.authority, certificate.public_bytes(serialization.Encoding.PEM))


def _issue(site: Site, name: str, authority: tls.Identity) -> None:
    signer = serialization.load_pem_private_key(authority.key.read_bytes(), None)
    assert isinstance(signer, ec.EllipticCurvePrivateKey)
    issuer = x509.load_pem_x509_certificate(authority.authority.read_bytes()).subject
    key = ec.generate_private_key(ec.SECP256R1())
    usages = [ExtendedKeyUsageOID.CLIENT_AUTH]
    builder = _builder(_name(name), issuer, key.public_key(), _CERTIFICATE_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    if name == "router":
        usages.append(ExtendedKeyUsageOID.SERVER_AUTH)
        builder = builder.add_extension(x509.SubjectAlternativeName([_host(site)]), critical=False)
    certificate = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False).sign(
        signer, hashes.SHA256()
    )
    files = tls.files(site, name)
    _write(files.key, _pem(key))
    _write(files.certificate, certificate.public_bytes(serialization.Encoding.PEM))


def _host(site: Site) -> x509.GeneralName:
    host = site.bus.router.removeprefix("tls/").rpartition(":")[0].strip("[]")
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now + datetime.timedelta(days=days))
    )


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _write(path: Path, data: bytes) -> None:
    # The certificate is written after its key: where there is one, there is the other.
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)


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
