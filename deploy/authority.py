"""A private certificate authority, and the certificates that it issues: for a site (`deploy.certificates`)
or for a pool (`rodeo_pool.authority`)."""

from __future__ import annotations

import datetime
import ipaddress
import os
from collections.abc import Sequence
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from rodeo.site.tls import Identity

_AUTHORITY_DAYS = 3650
_CERTIFICATE_DAYS = 825
"""Longest validity of a private authority's certificate that browsers and Apple's platforms accept."""

_SKEW = datetime.timedelta(hours=1)
"""A new certificate is valid on machines whose clocks differ by less than this."""


def make_authority(files: Identity, title: str) -> None:
    """Write the authority's certificate and private key to `files`."""
    files.authority.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(title)
    certificate = (
        _builder(name, name, key.public_key(), _AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    _write(files.key, _pem(key))
    _write(files.authority, certificate.public_bytes(serialization.Encoding.PEM))


def issue(
    files: Identity, name: str, authority: Identity, *, listens: bool = False, hosts: Sequence[str] = ()
) -> None:
    """Write a certificate for `name`, and its private key, to `files`. `listens`: others connect to it, too,
    at one of `hosts`."""
    signer = serialization.load_pem_private_key(authority.key.read_bytes(), None)
    assert isinstance(signer, ec.EllipticCurvePrivateKey)
    issuer = x509.load_pem_x509_certificate(authority.authority.read_bytes()).subject
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(_name(name), issuer, key.public_key(), _CERTIFICATE_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    if hosts:
        names = x509.SubjectAlternativeName([_host(host) for host in hosts])
        builder = builder.add_extension(names, critical=False)
    usages = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if listens else [])]
    certificate = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False).sign(
        signer, hashes.SHA256()
    )
    _write(files.key, _pem(key))
    _write(files.certificate, certificate.public_bytes(serialization.Encoding.PEM))


def _host(host: str) -> x509.GeneralName:
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
