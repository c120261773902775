"""A server of the files in a folder, the texts packed in advance: all that loading them can cost.

`python -m benchmarks.web.bare FOLDER` prints its address.
"""

from __future__ import annotations

import gzip
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
TYPES |= {".json": "application/json", ".webp": "image/webp"}
PACKED = {".js", ".css", ".svg"}
MISSING = b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"


def response(file: Path) -> bytes:
    """Return the whole response with a file."""
    data = file.read_bytes()
    head = f"HTTP/1.1 200 OK\r\nContent-Type: {TYPES[file.suffix]}\r\nCache-Control: no-cache\r\n"
    if file.suffix in PACKED:
        data = gzip.compress(data)
        head += "Content-Encoding: gzip\r\n"
    return f"{head}Content-Length: {len(data)}\r\n\r\n".encode() + data


class Handler(BaseHTTPRequestHandler):
    """Sends the response of a path in one piece."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    by_path: ClassVar[dict[str, bytes]] = {}

    def do_GET(self) -> None:
        self.wfile.write(self.by_path.get(self.path, MISSING))


def main() -> None:
    Handler.by_path = {f"/{file.name}": response(file) for file in Path(sys.argv[1]).iterdir()}
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    print(f"http://127.0.0.1:{server.server_port}", flush=True)
    server.serve_forever()


main()
