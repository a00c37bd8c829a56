"""The honest runs and forgeries of a charge."""

from rodeo_kinds.battery_charging.harness import others as others
from rodeo_kinds.battery_charging.harness import seller as seller
from rodeo_kinds.battery_charging.harness.workshop import HARNESS

__all__ = ["HARNESS"]
