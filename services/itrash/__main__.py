import sys

from rodeo.service import main
from services.itrash.app import run

sys.exit(main("itrash", run, "The smart bin: classifies what it is shown, confirms what falls in."))
