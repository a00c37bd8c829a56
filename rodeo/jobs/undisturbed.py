"""The first module that the fork server loads: Ctrl-C reaches it, too, and is for its parent alone."""

import signal

signal.signal(signal.SIGINT, signal.SIG_IGN)
