"""Where a site's router is, and how closed that makes its bus.

unixsock-stream/<path>  a socket of this machine, in a folder that only the site's user can open
tls/<host>:<port>       certificates of the site's own authority, and the router's access rules
anything else           open: whoever reaches it may speak as any process; needs `bus.open = true`
"""

from __future__ import annotations

import hashlib
import os
import socket
import stat
from contextlib import suppress
from pathlib import Path

from rodeo.errors import PortUnavailable, UnsafeSocketFolder

LOCAL = "local"
"""What `bus.router` is by default: a Unix socket beside the site's data."""

_SOCKET = "unixsock-stream/"
_TLS = "tls/"

_MAX_PATH_BYTES = 107
"""sun_path of unix(7) has 108 bytes, the last of which is a zero."""

_SHORT = Path("/tmp")
"""Where the socket goes if the path of the data directory cannot be that of one. The sticky bit there keeps
others from renaming our folder; not $TMPDIR or $XDG_RUNTIME_DIR, which may differ between two shells."""

_OWNER_ONLY = 0o700


def wants_certificates(router: str) -> bool:
    """Whether the router at this endpoint lets in only those who show a certificate of the site."""
    return router.startswith(_TLS)


CLOSED_INSTEAD = (
    "leave bus.router out (a socket that only this user can open), or set bus.router = "
    '"tls/<address>:<port>" (certificates and access rules)'
)
"""What to write for a bus that nobody else can speak on."""


def is_local(router: str) -> bool:
    """Whether this endpoint is a Unix socket."""
    return router.startswith(_SOCKET)


def problem(router: str, is_open: bool) -> str:
    """What is wrong with `bus.router`; empty when nothing is. `is_open` is `bus.open`."""
    if router == LOCAL:
        return ""
    if is_local(router) or wants_certificates(router):
        # Behind ? and # Zenoh takes options of the link, among them one that asks for no certificate.
        if _has_options(router):
            return f"{router}: options behind ? or # could open a closed bus; leave them out"
        if is_local(router):
            return _problem_of_path(Path(router.removeprefix(_SOCKET)))
        return ""
    if is_open:
        return ""
    return (
        f"{router} lets whoever reaches it speak as any process: {CLOSED_INSTEAD}, or accept the open bus "
        "with bus.open = true"
    )


def _has_options(router: str) -> bool:
    return any(mark in router for mark in "?#")


def _problem_of_path(path: Path) -> str:
    if not path.is_absolute():
        return f"{path}: the path of a socket begins with /"
    if len(os.fsencode(path)) > _MAX_PATH_BYTES:
        return f"{path}: the path of a socket has at most {_MAX_PATH_BYTES} bytes"
    return ""


def local_socket(data_dir: Path) -> str:
    """The endpoint of a site's own socket: the same for all its processes, whatever their environment."""
    path = data_dir.absolute() / "bus" / "router.sock"
    if len(os.fsencode(path)) > _MAX_PATH_BYTES or _has_options(str(path)):
        digest = hashlib.sha256(os.fsencode(data_dir.absolute())).hexdigest()[:16]
        path = _SHORT / f"rodeo-{os.geteuid()}-{digest}" / "router.sock"
    return f"{_SOCKET}{path}"


def make_socket_folder(router: str) -> None:
    """Make the folder of a socket, for its owner alone.

    Raises PortUnavailable when it cannot be made, and UnsafeSocketFolder if another stands there.
    """
    if not is_local(router):
        return
    folder = _folder(router)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            folder.mkdir(mode=_OWNER_ONLY)
    except OSError as error:
        raise PortUnavailable(
            f"cannot make the folder of the bus's socket: {error.strerror}", path=str(folder)
        ) from error
    check_socket_folder(router)


def check_socket_folder(router: str) -> None:
    """Raises UnsafeSocketFolder unless the folder of a socket is this user's alone, or is not there yet."""
    if not is_local(router):
        return
    folder = _folder(router)
    try:
        found = folder.lstat()
    except FileNotFoundError:
        return
    except PermissionError as error:
        raise UnsafeSocketFolder(
            "the folder of the bus's socket cannot be read by this user", path=str(folder)
        ) from error
    if not stat.S_ISDIR(found.st_mode):
        raise UnsafeSocketFolder(
            "the bus's socket needs a folder here, but this is not a folder", path=str(folder)
        )
    if found.st_uid != os.geteuid():
        raise UnsafeSocketFolder(
            "the folder of the bus's socket belongs to another user",
            path=str(folder),
            owner=found.st_uid,
            expected=os.geteuid(),
        )
    mode = stat.S_IMODE(found.st_mode)
    # What a shared folder hands down, setgid, opens nothing to anybody; and chmod 700 leaves it there.
    if mode & 0o777 != _OWNER_ONLY:
        raise UnsafeSocketFolder(
            "the folder of the bus's socket is open to others: stop the site, then chmod 700 the folder",
            path=str(folder),
            mode=f"{mode:04o}",
            expected=f"{_OWNER_ONLY:04o}",
        )


def _folder(router: str) -> Path:
    return Path(router.removeprefix(_SOCKET)).parent


def free_port() -> int:
    """A port of this machine on which nothing listens now."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])
