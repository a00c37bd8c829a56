import sys

from rodeo.process import main
from services.itrash.process import run

sys.exit(main("itrash", run, "The smart bin: classifies items and confirms what falls in."))
