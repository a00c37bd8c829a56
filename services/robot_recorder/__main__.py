"""`python -m services.robot_recorder --site FILE [--robot NAME]`"""

import sys

from rodeo.runtime.process import main_of_one
from rodeo.site.names import robot_process
from rodeo.site.processes import robots_with
from rodeo.site.topics import RECORDER
from services.robot_recorder.process import run

if __name__ == "__main__":
    sys.exit(
        main_of_one(
            RECORDER,
            "robot",
            lambda site: list(robots_with(site, RECORDER)),
            robot_process,
            run,
            "records what the robot's mind, a ROS 2 node, does",
        )
    )
