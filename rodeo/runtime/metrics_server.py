"""Health and metrics of every process, over HTTP on an address of its own.

GET /metrics            Prometheus text: `rodeo_ready`, `rodeo_bus_connected`, requests, the process's own
GET /livez, /readyz     as on every server of a site (rodeo.host.http)
"""

from __future__ import annotations

from collections.abc import Callable

from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from rodeo.bus.messages import Status
from rodeo.host.http import HttpServer, answer_with_problems, health


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
