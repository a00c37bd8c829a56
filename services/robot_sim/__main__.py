import argparse
import sys
import threading
from pathlib import Path

from rodeo.runtime.process import noting_its_end, supervise
from rodeo.site.config import Site
from services.robot_sim.process import run

parser = argparse.ArgumentParser(
    prog="robot_sim", description="The simulated lab and robot on the ROS 2 plane."
)
parser.add_argument("--site", type=Path, required=True, help="site file (TOML)")
parser.add_argument(
    "--fresh", action="store_true", help="start a new world instead of continuing the saved one"
)
arguments = parser.parse_args()


def body(stop: threading.Event) -> None:
    site = Site.load(arguments.site)
    with noting_its_end(site.data_dir / "robot_sim", stop):
        run(site, stop, fresh=arguments.fresh)


sys.exit(
    supervise(
        "robot_sim",
        body,
        stop_s=2.5,  # the world is on disk after every control period
    )
)
