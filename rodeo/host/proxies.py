"""Which proxy of the environment an address is asked by: one policy for every client of a site.

Loopback is asked directly, whatever the environment says. Other addresses are asked by HTTP_PROXY,
HTTPS_PROXY or ALL_PROXY, in capitals or small letters, unless NO_PROXY names them.
"""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit
from urllib.request import getproxies, proxy_bypass

from rodeo.errors import ConfigError

_SCHEMES = {"ws": "http", "wss": "https"}
"""A WebSocket begins as a request of HTTP."""


def is_loopback(host: str) -> bool:
    """Whether a host is this machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")


def proxy_of(url: str) -> str | None:
    """The proxy by which `url` is asked; None to ask directly. Raises ConfigError for one that is no HTTP
    proxy."""
    parts = urlsplit(url)
    host = parts.hostname or ""
    if is_loopback(host) or proxy_bypass(host):
        return None
    known = getproxies()
    found = known.get(_SCHEMES.get(parts.scheme, parts.scheme)) or known.get("all")
    if not found:
        return None
    proxy = found if "://" in found else f"http://{found}"
    try:
        told = urlsplit(proxy)
        is_one = told.scheme in ("http", "https") and bool(told.hostname) and told.port != 0
    except ValueError:
        is_one = False
    if not is_one:
        raise ConfigError(
            "the environment names a proxy that is no HTTP proxy: set HTTP_PROXY or HTTPS_PROXY to an "
            "address like http://proxy.example:3128, or name this host in NO_PROXY",
            host=host,
        )
    return proxy
