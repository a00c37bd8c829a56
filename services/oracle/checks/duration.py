"""Does the time in the recording pass as it passed on site and on chain?"""

import numpy as np

from rodeo.dao import CHARGING
from rodeo.evidence.recorder import EVENT_CHANNEL
from services.oracle.case import Case, increasing
from services.oracle.checks.completeness import streams
from services.oracle.report import Finding, at_most

DRIFT_SHARE = 0.1
"""Of the recording. Whoever speeds it up or slows it down gains nothing from less."""
LATE_WALL_S = 5.0
"""What a busy recorder may be late, of wall time: more of site time where the clock is faster."""
FASTEST = 50.0
"""How many times faster than real time a simulated clock without a set speed goes."""


def recorded_time(case: Case) -> Finding:
    """As much time passes between the messages' own stamps as between their log times."""
    drifts = {}
    for topic, name in streams(case):
        table = case.proof.table("/" + name, topic.type)
        lag_s = table.log_ns * 1e-9 - increasing(table)
        # Medians, so that a recorder that once stood still for a moment is no drift.
        quarter = max(1, len(lag_s) // 4)
        drifts[name] = float(abs(np.median(lag_s[-quarter:]) - np.median(lag_s[:quarter])))
    worst = max(drifts, key=lambda name: drifts[name])
    return at_most(
        drifts[worst],
        DRIFT_SHARE * (case.proof.end_ns - case.proof.start_ns) * 1e-9 + _late_s(case),
        "s",
        source="stamps of the publishers against the recorder's clock",
        detail=f"apart by the end, in /{worst}",
    )


def stated_in_time(case: Case) -> Finding:
    """Nothing was recorded before it was said: neither other devices' statements nor the chain's events."""
    early_s = [float(s.payload["time_s"]) - s.log_s for s in case.stated(None, "time_s")]
    log_ns = case.proof.topics[EVENT_CHANNEL].log_ns if case.events else []
    for event, recorded_ns in zip(case.events, log_ns, strict=True):
        if "block" in event:
            early_s.append(float(event["time_s"]) - recorded_ns * 1e-9)
    return at_most(
        max(early_s, default=0.0),
        _late_s(case),
        "s",
        source="times in signed statements and blocks",
        detail="recorded before it happened by",
    )


def _late_s(case: Case) -> float:
    clock = case.site.clock
    if clock.source == "wall":
        return LATE_WALL_S
    speed = clock.idle_speed if case.kind == CHARGING else clock.speed
    return LATE_WALL_S * max(speed or FASTEST, 1.0)
