"""`python -m services.itrash --site FILE [--bin NAME]`"""

import sys

from rodeo.runtime.process import main_of_one
from rodeo.site.names import bin_process
from services.itrash.process import run

DESCRIPTION = "A smart bin: classifies items and confirms what falls in."

if __name__ == "__main__":
    sys.exit(
        main_of_one(
            "itrash", "bin", lambda site: [one.name for one in site.bins], bin_process, run, DESCRIPTION
        )
    )
