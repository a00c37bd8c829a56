"""A camera on the network: MJPEG over HTTP, as cheap ones speak it."""

from __future__ import annotations

import threading
import time
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
        self.ahead_s = 0.0
        """By how much its clock, which its stream names, is off."""
        self.frozen = False
        """Whether it shows the last picture again and again."""
        self._last, self._count = b"", 0
        video = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
                self.end_headers()
                pause = threading.Event()
                while True:
                    data = video.frame()
                    told = f"X-Timestamp: {time.time() + video.ahead_s:.3f}\r\nContent-Length: {len(data)}"
                    head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\n{told}\r\n\r\n"
                    try:
                        self.wfile.write(head.encode() + data + b"\r\n")
                    except OSError:
                        return  # the client went away
                    pause.wait(PERIOD_S)

            def log_message(self, format: str, *_args: object) -> None:
                """Each request would be a line."""

        self._picture = picture
        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def frame(self) -> bytes:
        """No two pictures of a sensor are equal: here a comment in the file counts them."""
        if not self.frozen or not self._last:
            self._count += 1
            comment = f"{self._count:08d}".encode()
            data = self._picture()
            # After the marker of the beginning: FF FE, the length with itself, the comment.
            self._last = data[:2] + b"\xff\xfe\x00\x0a" + comment + data[2:]
        return self._last
