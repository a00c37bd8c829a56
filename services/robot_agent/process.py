"""The agent as a process."""

from __future__ import annotations

import threading
from contextlib import ExitStack

from rodeo.errors import ConfigError
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site.config import Site
from rodeo.site.names import robot_process
from services.robot_agent.assembly import assembled


def run(site: Site, robot: str, stop: threading.Event) -> None:
    """Drive `robot` until `stop`. Raises ConfigError for an unknown name, and for a robot that has another
    mind."""
    config = site.robot(robot)
    if config.mind is not None:
        raise ConfigError(f"the mind of {robot} is {config.mind}: start its robot_recorder", robot=robot)
    name = robot_process(site, config.name)
    with Process(name, site, stop) as process:
        process.serve_alone(served_by(site, name))
        process.wait_clock()
        process.not_ready("waiting for the organization")
        with ExitStack() as closing:
            agent = assembled(process, config, closing)
            with process.clock.acting(), closing.pop_all():
                agent.live()
