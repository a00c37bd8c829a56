"""Secrets in addresses, such as a provider's key in `chain.url`: nothing that is printed or sent has them.

`learn` takes the secrets from the settings when a site is loaded. `shown` is an address for people.
Exceptions of other libraries quote whole addresses, so every way out of a process passes its text through
`redacted`: logs, status, errors on the bus, problems over HTTP, the command line, and the note of how a
process ended.
"""

from __future__ import annotations

import base64
import re
import sys
import threading
import traceback
from collections.abc import Iterator
from typing import Any
from urllib.parse import SplitResult, parse_qsl, unquote, urlsplit

HIDDEN = "***"

_SHORTEST = 6
"""Characters of a password or key that is hidden wherever it stands alone. A shorter one is hidden inside its
address only: it may be a word that stands in any text."""

_CREDENTIALS = re.compile(r"(?<=://)[^/\s@'\"]*:[^/\s@'\"]*@")
"""Name and password in an address that no setting holds."""

_known: dict[str, str] = {}
_pattern: re.Pattern[str] | None = None


def learn(address: str, path_is_secret: bool = False) -> None:
    """Hide the secrets in `address` from now on: password and query, with `path_is_secret` its path, too."""
    global _pattern
    _known.update((text, shorter) for text, shorter in _secrets(address, path_is_secret) if text != shorter)
    longest_first = sorted(_known, key=len, reverse=True)
    _pattern = re.compile("|".join(map(re.escape, longest_first))) if longest_first else None


def hide(secret: str) -> None:
    """Hide `secret` from now on."""
    learn(f"//host?={secret}")


def shown(address: str) -> str:
    """Scheme, host and port of `address`, and `/...` where more follows."""
    try:
        parts = urlsplit(address)
    except ValueError:
        return HIDDEN
    more = parts.path.strip("/") or parts.query or parts.fragment
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}" + ("/..." if more else "")


def redacted(text: str) -> str:
    """`text` without the secrets."""
    if _pattern is not None:
        text = _pattern.sub(lambda found: _known[found.group()], text)
    return _CREDENTIALS.sub("", text) if "://" in text else text


def redacted_json(value: Any) -> Any:
    """The same of every text in a JSON value. What JSON does not know is left as it is."""
    match value:
        case str():
            return redacted(value)
        case dict():
            return {key: redacted_json(one) for key, one in value.items()}
        case list() | tuple():
            return [redacted_json(one) for one in value]
    return value


def hide_in_tracebacks() -> None:
    """Leave the secrets out of what Python writes to standard error when a program or a thread fails."""

    def write(error: BaseException | None) -> None:
        if error is not None:
            sys.stderr.write(redacted("".join(traceback.format_exception(error))))

    sys.excepthook = lambda _type, error, _traceback: write(error)
    threading.excepthook = lambda ended: write(ended.exc_value)


def _secrets(address: str, path_is_secret: bool) -> Iterator[tuple[str, str]]:
    """Each text to hide, and what stands in its place."""
    try:
        parts = urlsplit(address)
    except ValueError:
        yield address, HIDDEN
        return
    alone = [*_credentials(parts), *(value for _, value in parse_qsl(parts.query)), parts.fragment]
    if path_is_secret:
        yield address, shown(address)
        alone += parts.path.split("/")
        if len(parts.path) >= _SHORTEST:
            yield parts.path, "/..."
    if user := parts.netloc.rpartition("@")[0]:
        yield f"{user}@", ""
    if parts.query:
        yield f"?{parts.query}", f"?{HIDDEN}"
    for secret in alone:
        for form in (secret, unquote(secret)):
            if len(form) >= _SHORTEST:
                yield form, HIDDEN


def _credentials(parts: SplitResult) -> Iterator[str]:
    """The password, alone and as HTTP's header has it; a name without one is a key where HTTP is spoken."""
    name, password = parts.username or "", parts.password or ""
    if password:
        yield password
        yield base64.b64encode(f"{unquote(name)}:{unquote(password)}".encode()).decode()
    elif parts.scheme in ("http", "https", "ws", "wss"):
        yield name
