import sys

from rodeo.process import main
from services.itrash.process import run

sys.exit(main("itrash", run, "The smart bin: classifies what it is shown, confirms what falls in."))
