"""A machine whose clock is LAB_CLOCK_AHEAD_S ahead: found by Python before the process's own code."""

import os
import time

_AHEAD_NS = round(float(os.environ["LAB_CLOCK_AHEAD_S"]) * 1e9)
_time_ns = time.time_ns
time.time_ns = lambda: _time_ns() + _AHEAD_NS
time.time = lambda: time.time_ns() * 1e-9
