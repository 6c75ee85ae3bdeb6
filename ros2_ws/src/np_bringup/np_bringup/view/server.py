"""The page and its data over HTTP, from the standard library; on this machine only by default."""

from __future__ import annotations

import json
import secrets
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from urllib.parse import parse_qs, urlparse

PAGE = files("np_bringup") / "data" / "view.html"
LOOPBACK = ("127.0.0.1", "localhost")


def serve(source, host: str, port: int) -> ThreadingHTTPServer:
    """A running server: / the page, /scene.json, /episode.json or /state.json of the source, /image.jpg?time=s.

    port 0 takes a free one. At an address that others can reach all of it lies below a secret path, which only `server.address`, the
    URL, contains. End it with `shutdown`. Raises OSError where the port is taken.
    """
    page = PAGE.read_bytes()
    secret = "" if host in LOOPBACK else f"/{secrets.token_urlsafe(16)}"

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):  # noqa: N802  the name is http.server's
            if not self.path.startswith(f"{secret}/"):
                return self.send_error(403, "expected the whole address that view printed")
            url = urlparse(self.path.removeprefix(secret))
            name = url.path.removeprefix("/").removesuffix(".json")
            if url.path == "/":
                self._answer("text/html; charset=utf-8", page)
            elif url.path == "/image.jpg":
                self._image(parse_qs(url.query).get("time", ["0"])[0])
            elif name in ("scene", "episode", "state") and hasattr(source, name):
                self._answer("application/json", json.dumps(getattr(source, name)()).encode())
            else:
                self.send_error(404, f"expected /, scene.json, episode.json, state.json or image.jpg, got {url.path}")

        def _image(self, time: str) -> None:
            try:
                picture = source.image(float(time))
            except ValueError:
                return self.send_error(400, f"time: expected seconds, got {time}")
            if picture is None:
                return self.send_error(404, "no image")
            self._answer("image/jpeg", picture)

        def _answer(self, kind: str, content: bytes) -> None:
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *arguments):
            """Log nothing: there are twenty requests a second."""

    try:
        server = ThreadingHTTPServer((host, port), Handler)
    except OSError as error:
        raise OSError(
            f"--port {port}, --host {host}: expected a free address of this machine: {error.strerror}"
        ) from None
    server.daemon_threads = True
    server.address = f"http://{server.server_address[0]}:{server.server_port}{secret}/"
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server
