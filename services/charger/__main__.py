import sys

from rodeo.process import main
from services.charger.process import run

sys.exit(
    main("charger", run, "The dock's energy meter: charges robots and proves the energy that it delivered.")
)
