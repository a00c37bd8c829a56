"""Health and metrics of every process, over HTTP on an address of its own.

    GET /metrics            Prometheus text: `rodeo_ready`, `rodeo_bus_connected`, requests, the process's own
    GET /livez, /readyz     as on every server of a site (rodeo.http)

Metrics are prometheus_client's own: a module declares its `Gauge` or `Histogram` where it
measures, and they appear here.
"""

from __future__ import annotations

from collections.abc import Callable

from prometheus_client import CONTENT_TYPE_LATEST, Counter, Gauge, Histogram, generate_latest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from rodeo.http import HttpServer, answer_with_problems, health
from rodeo.messages import Status

LATENCY_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)

REQUESTS = Histogram(
    "rodeo_request_seconds",
    "Wall time from a query on the bus to its reply",
    ["key", "outcome"],
    buckets=LATENCY_BUCKETS_S,
)
"""`key` as served, with its wildcards; `outcome` is `ok` or the error's code."""

READY = Gauge("rodeo_ready", "1 when the process does its work")
BUS_CONNECTED = Gauge("rodeo_bus_connected", "1 while there is a router")
NOT_READY = Counter("rodeo_not_ready_total", "Times that the process stopped being ready")

RECORDER_REFUSED = Counter(
    "rodeo_recorder_refused_total", "What a recorder heard and did not write", ["what", "reason"]
)
"""`what` is `message` or `statement`; reasons are those of `rodeo.recording.Refusal`."""
HEADS_REFUSED = Counter(
    "rodeo_heads_refused_total", "What a witness heard that no registered device of its organization signed"
)
SEALS_UNPUBLISHED = Counter("rodeo_seals_unpublished_total", "Seals that the bus did not take")


def metrics_server(host: str, port: int, status: Callable[[], Status]) -> HttpServer:
    """Serves metrics and `status()` on `host`:`port` (0 takes a free one) while it is open.

    Raises PortUnavailable.
    """

    def metrics(_request: Request) -> Response:
        status()  # sets the gauges
        return Response(generate_latest(), media_type=CONTENT_TYPE_LATEST)

    def why_not_ready() -> str:
        now = status()
        return "" if now.ready else now.reason or "not ready"

    api = Starlette(routes=[Route("/metrics", metrics), *health(why_not_ready)])
    answer_with_problems(api)
    return HttpServer(api, host, port, "metrics (metrics.ports)")
