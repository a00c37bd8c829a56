"""`python -m services.robot_agent --site FILE [--robot NAME]`"""

import argparse
import sys
from pathlib import Path

from rodeo.config import Site
from rodeo.service import supervise
from services.robot_agent.process import run


def main() -> int:
    parser = argparse.ArgumentParser(prog="robot_agent", description="the robot's mind")
    parser.add_argument("--site", type=Path, required=True, help="site file (TOML)")
    parser.add_argument("--robot", help="the robot to drive; the site's first by default")
    arguments = parser.parse_args()
    name = f"robot_agent {arguments.robot}" if arguments.robot else "robot_agent"
    return supervise(name, lambda stop: run(Site.load(arguments.site), arguments.robot, stop))


if __name__ == "__main__":
    sys.exit(main())
