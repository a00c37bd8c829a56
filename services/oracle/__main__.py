import sys

from rodeo.process import main
from services.oracle.process import run

if __name__ == "__main__":
    # Spawned verifications import this module again and must not start another oracle.
    sys.exit(main("oracle", run, "Verifies proofs of work and posts verdicts."))
