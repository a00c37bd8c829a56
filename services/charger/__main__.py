"""`python -m services.charger --site FILE [--dock NAME]`"""

import sys

from rodeo.runtime.process import main_of_one
from rodeo.site.names import dock_process
from services.charger.process import run

DESCRIPTION = "A dock's energy meter: charges robots and proves the energy that it delivered."

if __name__ == "__main__":
    sys.exit(
        main_of_one(
            "charger", "dock", lambda site: [one.name for one in site.docks], dock_process, run, DESCRIPTION
        )
    )
