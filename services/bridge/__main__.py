"""python -m services.bridge --site deploy/sites/lab.toml"""

import sys

from rodeo.process import main
from services.bridge.process import run

if __name__ == "__main__":
    sys.exit(
        main("bridge", run, "Signs, sends and indexes for the participants.", lambda site: site.bridge.name)
    )
