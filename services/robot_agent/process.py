"""The agent as a process."""

from __future__ import annotations

import threading

from rodeo.config import Site
from rodeo.service import Service
from services.robot_agent.agent import Agent


def run(site: Site, stop: threading.Event) -> None:
    """Drive the site's first robot until `stop`; a site with more robots runs one agent for each."""
    with Service("robot_agent", site, stop) as service:
        service.wait_clock()
        service.not_ready("waiting for the organization")
        Agent(service, site.robots[0]).run()
