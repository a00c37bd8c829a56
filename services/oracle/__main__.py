"""`python -m services.oracle --site FILE [--oracle NAME]`"""

import sys

from rodeo.runtime.process import main_of_one
from rodeo.site.names import oracle_names, oracle_process
from services.oracle.process import run

if __name__ == "__main__":
    # Spawned verifications import this module again and must not start another oracle.
    description = "Verifies proofs of work and posts verdicts."
    sys.exit(main_of_one("oracle", "oracle", oracle_names, oracle_process, run, description))
