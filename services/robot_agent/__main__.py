"""`python -m services.robot_agent --site FILE [--robot NAME]`"""

import sys

from rodeo.runtime.process import main_of_one
from rodeo.site.config import agent_process
from services.robot_agent.process import run

if __name__ == "__main__":
    sys.exit(
        main_of_one(
            "robot_agent",
            "robot",
            lambda site: [one.name for one in site.robots],
            agent_process,
            run,
            "the robot's mind",
        )
    )
