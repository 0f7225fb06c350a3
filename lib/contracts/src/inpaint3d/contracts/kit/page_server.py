"""A server of local pages: this machine alone may ask, and only who knows the token.

Every path begins with the token, so that all that the page fetches has it and nothing else does. Whoever makes a
browser ask under another name (DNS rebinding) is told by `Host`, another site's page by `Origin`.
"""

import json
import re
import secrets
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, cast

from pydantic import ValidationError

from inpaint3d.contracts.errors import Inpaint3dError
from inpaint3d.contracts.models.manifest import first_error
from inpaint3d.contracts.models.untrusted import UntrustedError, parse_json

LOOPBACK = "127.0.0.1"
MAX_BODY_BYTES = 256 * 1024
MAX_PICTURE_BYTES = 128 * 1024 * 1024
"""Of a picture that is put on the page: 16 bits of 20 megapixels, not compressed."""
PICTURES = ("image/png", "image/tiff")
MAX_CONNECTIONS = 32
IDLE_S = 30.0
"""A connection that says nothing for so long is closed."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True)
class Answer:
    """What is sent back."""

    body: bytes
    kind: str = "application/json"
    status: HTTPStatus = HTTPStatus.OK
    policy: str = POLICY
    """What a browser may load for it."""


class Refusal(Exception):
    """A request that is not answered: why, in words for who reads it."""

    def __init__(self, status: HTTPStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


Get = Callable[[str], Answer]
Post = Callable[[str, Any], Answer]
Put = Callable[[str, bytes], Answer]
"""A path without its token (`frames/frame_000.jpg`); for POST with the JSON value, for PUT with the picture sent."""


def answer_json(value: Any, status: HTTPStatus = HTTPStatus.OK) -> Answer:
    return Answer(json.dumps(value, allow_nan=False).encode(), status=status)


class PageServer(ThreadingHTTPServer):
    """Listens on the loopback address alone; port 0 takes any that is free."""

    daemon_threads = True
    request_queue_size = MAX_CONNECTIONS

    def __init__(self, get: Get, post: Post | None = None, port: int = 0, *, put: Put | None = None) -> None:
        """Without `post` and `put` nothing can be sent: what is served is to be read only."""
        super().__init__((LOOPBACK, port), _Handler)
        self.get, self.post, self.put = get, post, put
        self.token = secrets.token_urlsafe(24)
        self._free = threading.BoundedSemaphore(MAX_CONNECTIONS)

    @property
    def hosts(self) -> frozenset[str]:
        """What a browser on this machine calls the server."""
        return frozenset(f"{name}:{self.server_port}" for name in (LOOPBACK, "localhost"))

    @property
    def url(self) -> str:
        return f"http://{LOOPBACK}:{self.server_port}/{self.token}/"

    def announce_and_serve(self) -> None:
        """Say on standard output where the pages are, and serve them until Ctrl-C, which the caller catches."""
        sys.stdout.write(f"open {self.url} in a browser of this machine; Ctrl-C here ends it\n")
        sys.stdout.flush()
        self.serve_forever()

    def process_request(self, request: Any, client_address: Any) -> None:
        """A thread for each connection, up to a limit; what comes above it is closed."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002 - the library's signature
        """Who goes away in the middle is no error."""
        if not isinstance(sys.exception(), ConnectionError):
            traceback.print_exc()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "inpaint3d", ""
    timeout = IDLE_S
    _policy = POLICY

    @property
    def _page(self) -> PageServer:
        return cast(PageServer, self.server)

    def do_GET(self) -> None:
        self._answer(lambda path: self._page.get(path))

    def do_POST(self) -> None:
        self._answer(self._post)

    def do_PUT(self) -> None:
        self._answer(self._put)

    def _put(self, path: str) -> Answer:
        if self._page.put is None:
            raise Refusal(HTTPStatus.METHOD_NOT_ALLOWED, "no picture can be put on this page")
        if self.headers.get_content_type() not in PICTURES:
            raise Refusal(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, f"what is put here is to be {' or '.join(PICTURES)}")
        return self._page.put(path, self._read_bytes(MAX_PICTURE_BYTES))

    def _post(self, path: str) -> Answer:
        if self._page.post is None:
            raise Refusal(HTTPStatus.METHOD_NOT_ALLOWED, "nothing can be sent to this page")
        return self._page.post(path, self._read_body())

    def end_headers(self) -> None:
        """Every answer, also one of the library's own, says what a browser may do with it."""
        for name, value in {**HEADERS, "Content-Security-Policy": self._policy}.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the library's signature
        """Nothing: paths hold the token."""

    def _answer(self, method: Callable[[str], Answer]) -> None:
        try:
            self._send(method(self._find_path()))
        except Refusal as error:
            self.close_connection = True  # its body may not have been read
            self._send(answer_json({"error": str(error)}, error.status))
        except ValidationError as error:
            self._send(answer_json({"error": first_error(error)}, HTTPStatus.BAD_REQUEST))
        except Inpaint3dError as error:
            self._send(answer_json({"error": str(error)}, HTTPStatus.UNPROCESSABLE_ENTITY))
        except (TimeoutError, ConnectionError):
            self.close_connection = True
        except Exception:
            traceback.print_exc()
            self.close_connection = True
            message = "an error of the program, which its terminal shows"
            self._send(answer_json({"error": message}, HTTPStatus.INTERNAL_SERVER_ERROR))

    def _find_path(self) -> str:
        """What follows the token; Refusal for whoever may not ask."""
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or hosts[0].lower() not in self._page.hosts:
            raise Refusal(HTTPStatus.FORBIDDEN, "this server is asked under a name that is not its own")
        origin = self.headers.get("Origin")
        if origin is not None and origin.lower() not in {f"http://{host}" for host in self._page.hosts}:
            raise Refusal(HTTPStatus.FORBIDDEN, "this page may not be asked by another site's")
        _, _, path = self.path.partition("/")
        token, _, rest = path.partition("/")
        if not secrets.compare_digest(token.encode(), self._page.token.encode()):
            raise Refusal(HTTPStatus.FORBIDDEN, "open the address that the command printed, as it stands")
        return rest

    def _read_body(self) -> Any:
        """The JSON value that was sent, read within bounds."""
        if self.headers.get_content_type() != "application/json":
            raise Refusal(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "what is sent is to be application/json")
        try:
            return parse_json(self._read_bytes(MAX_BODY_BYTES))
        except UntrustedError as error:
            raise Refusal(HTTPStatus.BAD_REQUEST, str(error)) from error

    def _read_bytes(self, limit: int) -> bytes:
        """What was sent, of as many bytes as it says, and not more than the limit."""
        said = self.headers.get_all("Content-Length", [])
        if len(said) != 1 or "Transfer-Encoding" in self.headers or not re.fullmatch(r"[0-9]{1,9}", said[0]):
            raise Refusal(HTTPStatus.LENGTH_REQUIRED, "what is sent is to say its length")
        if (length := int(said[0])) > limit:
            raise Refusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"more than {limit // 1024} KiB were sent")
        data = self.rfile.read(length)
        if len(data) < length:
            raise Refusal(HTTPStatus.BAD_REQUEST, f"{length} bytes were announced, {len(data)} came")
        return data

    def _send(self, answer: Answer) -> None:
        self._policy = answer.policy
        self.send_response(answer.status)
        self.send_header("Content-Type", answer.kind)
        self.send_header("Content-Length", str(len(answer.body)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(answer.body)
