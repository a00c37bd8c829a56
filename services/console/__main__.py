import sys

from rodeo.service import main
from services.console.app import run

sys.exit(main("console", run, "The organization's web page and its interface for programs."))
