"""`python -m services.robot_agent --site FILE [--robot NAME]`"""

import argparse
import sys
import threading
from pathlib import Path

from rodeo.config import Site, agent_process
from rodeo.process import noting_its_end, supervise
from services.robot_agent.process import run


def main() -> int:
    parser = argparse.ArgumentParser(prog="robot_agent", description="the robot's mind")
    parser.add_argument("--site", type=Path, required=True, help="site file (TOML)")
    parser.add_argument("--robot", help="the robot to drive; the site's first by default")
    arguments = parser.parse_args()
    name = f"robot_agent {arguments.robot}" if arguments.robot else "robot_agent"

    def body(stop: threading.Event) -> None:
        site = Site.load(arguments.site)
        process = agent_process(site, arguments.robot or site.robots[0].name)
        with noting_its_end(site.data_dir / process, stop):
            run(site, arguments.robot, stop)

    return supervise(name, body)


if __name__ == "__main__":
    sys.exit(main())
