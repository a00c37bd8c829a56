"""The honest runs and forgeries of a cleaning."""

from rodeo_kinds.waste_disposal.harness import blinks as blinks
from rodeo_kinds.waste_disposal.harness import disturbed as disturbed
from rodeo_kinds.waste_disposal.harness import executor as executor
from rodeo_kinds.waste_disposal.harness import giving_up as giving_up
from rodeo_kinds.waste_disposal.harness import hearsay as hearsay
from rodeo_kinds.waste_disposal.harness import judges as judges
from rodeo_kinds.waste_disposal.harness import others as others
from rodeo_kinds.waste_disposal.harness import places as places
from rodeo_kinds.waste_disposal.harness.workshop import HARNESS

__all__ = ["HARNESS"]
