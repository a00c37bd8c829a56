"""Health and metrics of every process, over HTTP on an address of its own.

    GET /metrics   Prometheus text: `rodeo_ready`, `rodeo_bus_connected`, requests, and the process's own
    GET /livez     200 while the process runs
    GET /readyz    200 when it does its work, 503 with the reason when it does not

Kubernetes' names. Metrics are prometheus_client's own: a module declares its `Gauge` or `Histogram` where it
measures, and they appear here.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from prometheus_client import CONTENT_TYPE_LATEST, Counter, Gauge, Histogram, generate_latest

from rodeo.errors import PortUnavailable
from rodeo.messages import Status

log = logging.getLogger(__name__)

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

_TIMEOUT_S = 5.0


class MetricsServer:
    """Serves metrics and `status()` on `host`:`port` (0 takes a free one) until closed.

    Raises PortUnavailable.
    """

    def __init__(self, host: str, port: int, status: Callable[[], Status]) -> None:
        class Handler(BaseHTTPRequestHandler):
            timeout = _TIMEOUT_S

            def do_GET(self) -> None:
                if self.path == "/metrics":
                    status()  # sets the gauges
                    self._reply(200, generate_latest(), CONTENT_TYPE_LATEST)
                elif self.path == "/livez":
                    self._reply(200, b"ok\n")
                elif self.path == "/readyz":
                    now = status()
                    body = json.dumps({"process": now.process, "ready": now.ready, "reason": now.reason})
                    self._reply(200 if now.ready else 503, body.encode(), "application/json")
                else:
                    self._reply(404, b"metrics, livez, readyz\n")

            def _reply(self, status_code: int, body: bytes, content_type: str = "text/plain") -> None:
                self.send_response(status_code)
                self.send_header("content-type", content_type)
                self.send_header("content-length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:
                log.debug(format, *args)

        try:
            self._server = ThreadingHTTPServer((host, port), Handler)
        except OSError as error:
            raise PortUnavailable.of("metrics (metrics.ports)", host, port, error) from error
        self._server.daemon_threads = True
        address, bound = self._server.server_address[:2]
        self.url = f"http://{address!s}:{bound}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
