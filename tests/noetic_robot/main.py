"""The robot of `foreign_robot` as a node of ROS 1. It imports nothing of RODEO.

python tests/noetic_robot/main.py --namespace panther1 ... (as foreign_robot/robot.py)
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "foreign_robot"))

from robot import main

main()
