"""What every process measures; `rodeo.runtime.metrics_server` serves it.

Metrics are prometheus_client's own: a module declares its `Gauge` or `Histogram` where it measures.
"""

from __future__ import annotations

from prometheus_client import Counter, Gauge, Histogram

LATENCY_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)

REQUESTS = Histogram(
    "rodeo_request_seconds",
    "Wall time from a query on the bus to its reply",
    ["key", "outcome"],
    buckets=LATENCY_BUCKETS_S,
)
"""`key` as served, with its wildcards; `outcome` is `ok` or the error's code."""

READY = Gauge("rodeo_ready", "1 while the process is ready")
BUS_CONNECTED = Gauge("rodeo_bus_connected", "1 while there is a router")
NOT_READY = Counter("rodeo_not_ready_total", "Times that the process stopped being ready")

RECORDER_REFUSED = Counter(
    "rodeo_recorder_refused_total", "Messages that a recorder received but did not write", ["what", "reason"]
)
"""`what` is `message` or `statement`; reasons are those of `rodeo.recording.Refusal`."""
HEADS_REFUSED = Counter(
    "rodeo_heads_refused_total",
    "Seals and statements left out by a witness: on another device's key, badly signed, too many, or of a "
    "time to come",
)
SEALS_UNPUBLISHED = Counter("rodeo_seals_unpublished_total", "Seals that could not be published")
