"""`python -m services.mocap --site FILE`"""

import sys

from rodeo.runtime.process import main
from services.mocap.process import PROCESS, run

DESCRIPTION = (
    "The lab's motion capture: reads a system of cameras, publishes the poses of bodies and signs them."
)

if __name__ == "__main__":
    sys.exit(main(PROCESS, run, DESCRIPTION))
