"""`python -m services.robot_agent --site FILE [--robot NAME]`"""

import sys

from rodeo.runtime.process import main_of_one
from rodeo.site.minds import AGENT
from rodeo.site.names import robot_process
from rodeo.site.processes import robots_with
from services.robot_agent.process import run

if __name__ == "__main__":
    sys.exit(
        main_of_one(
            AGENT,
            "robot",
            lambda site: list(robots_with(site, AGENT)),
            robot_process,
            run,
            "the robot's mind",
        )
    )
