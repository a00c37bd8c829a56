"""The Zenoh router as a process: a session in router mode. A stock zenohd takes the same configuration."""

from __future__ import annotations

import json
import logging
import re
import sys
import threading
from pathlib import Path

import zenoh

from rodeo.errors import PortUnavailable
from rodeo.runtime.process import Process, main
from rodeo.site.config import Site
from rodeo.site.endpoint import make_socket_folder
from rodeo.site.tls import identity, openness

log = logging.getLogger(__name__)

CONFIG = Path(__file__).parent / "zenoh" / "router.json5"


def run(site: Site, stop: threading.Event) -> None:
    """Route until `stop`. Raises AlreadyRunning, PortUnavailable when the endpoint is taken, and
    UnsafeSocketFolder.
    """
    make_socket_folder(site.bus.router)
    config = zenoh.Config.from_file(str(CONFIG))
    config.insert_json5("listen/endpoints", json.dumps([site.bus.router]))
    if (shown := identity(site, "router")) is not None:
        # Imported here: an open bus has no rules, and those of a closed one need every command's model.
        from deploy.access import access_control

        config.insert_json5("transport/link/tls", json.dumps(shown.zenoh()))
        config.insert_json5("access_control", json.dumps(access_control(site)))

    def listen() -> zenoh.Session:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            # The library names the lines of its own source.
            reason = re.sub(r" at /\S+", "", str(error))
            raise PortUnavailable(f"cannot listen: {reason}", endpoint=site.bus.router) from error

    with Process("router", site, stop, listen) as process:
        if warning := openness(site):
            log.warning("%s", warning)
            process.notices.warn(warning)
        process.ready()
        process.activity(f"routing at {site.bus.router}")
        stop.wait()


if __name__ == "__main__":
    sys.exit(main("router", run, __doc__ or ""))
