"""The agent as a process."""

from __future__ import annotations

import threading

from rodeo.config import Site, agent_process
from rodeo.service import Service
from rodeo.serving import served_by
from services.robot_agent.agent import Agent


def run(site: Site, robot: str | None, stop: threading.Event) -> None:
    """Drive `robot`, by default the site's first, until `stop`. Raises ConfigError for an unknown name."""
    config = site.robot(robot or site.robots[0].name)
    process = agent_process(site, config.name)
    with Service(process, site, stop) as service:
        service.serve_alone(served_by(site, process))
        service.wait_clock()
        service.not_ready("waiting for the organization")
        Agent(service, config).run()
