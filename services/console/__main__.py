import sys

from rodeo.runtime.process import main
from services.console.process import run

sys.exit(main("console", run, "The organization's web page and its interface for programs."))
