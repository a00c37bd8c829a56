"""The agent as a process."""

from __future__ import annotations

import threading
from contextlib import ExitStack

from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site.config import Site, agent_process
from services.robot_agent.assembly import assembled


def run(site: Site, robot: str, stop: threading.Event) -> None:
    """Drive `robot` until `stop`. Raises ConfigError for an unknown name."""
    config = site.robot(robot)
    name = agent_process(site, config.name)
    with Process(name, site, stop) as process:
        process.serve_alone(served_by(site, name))
        process.wait_clock()
        process.not_ready("waiting for the organization")
        with ExitStack() as closing:
            agent = assembled(process, config, closing)
            with process.clock.acting(), closing.pop_all():
                agent.live()
