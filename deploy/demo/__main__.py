"""`python -m deploy.demo`."""

import signal
import sys

# Importing takes a second, in which there is nothing to stop: Ctrl-C ends the process without a traceback.
signal.signal(signal.SIGINT, signal.SIG_DFL)

from deploy.demo.run import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
