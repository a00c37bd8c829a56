"""`python -m services.bridge --site FILE [--bridge NAME]`"""

import sys

from rodeo.runtime.process import main_of_one
from rodeo.site.names import bridge_names, bridge_process
from services.bridge.process import run

if __name__ == "__main__":
    description = "Signs, sends and indexes for the participants."
    sys.exit(main_of_one("bridge", "bridge", bridge_names, bridge_process, run, description))
