import sys

from rodeo.service import main
from services.charger.app import run

sys.exit(main("charger", run, "The dock's energy meter: charges robots and proves what it delivered."))
