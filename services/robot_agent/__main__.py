"""`python -m services.robot_agent --site FILE`"""

import sys

from rodeo.service import main
from services.robot_agent.process import run

if __name__ == "__main__":
    sys.exit(main("robot_agent", run, "the robot's mind"))
