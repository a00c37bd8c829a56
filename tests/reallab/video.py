"""A camera on the network: MJPEG over HTTP, as cheap ones speak it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

PERIOD_S = 0.2
_BOUNDARY = "frame"


class Video:
    """A stream of pictures on a port of loopback.

    Args:
        picture: JPEG of what is in front of it now.
    """

    def __init__(self, port: int, picture: Callable[[], bytes]) -> None:
        self.plugged = True
        video = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
                self.end_headers()
                pause = threading.Event()
                while video.plugged:
                    data = picture()
                    head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                    try:
                        self.wfile.write(head.encode() + data + b"\r\n")
                    except OSError:
                        return  # the client went away
                    pause.wait(PERIOD_S)

            def log_message(self, format: str, *_args: object) -> None:
                """Each request would be a line."""

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
