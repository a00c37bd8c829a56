import argparse
import sys
from pathlib import Path

from rodeo.config import Site
from rodeo.service import supervise
from services.robot_sim.process import run

parser = argparse.ArgumentParser(
    prog="robot_sim", description="The simulated lab and robot on the ROS 2 plane."
)
parser.add_argument("--site", type=Path, required=True, help="site file (TOML)")
parser.add_argument(
    "--fresh", action="store_true", help="begin a new world instead of going on with the saved one"
)
arguments = parser.parse_args()
sys.exit(
    supervise(
        "robot_sim",
        lambda stop: run(Site.load(arguments.site), stop, fresh=arguments.fresh),
        stop_s=2.5,  # the world is on disk after every control period
    )
)
