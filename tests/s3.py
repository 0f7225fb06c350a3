"""An S3 server of the test's own, and a network before it that breaks when told to."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from urllib.parse import urlparse

import boto3
import pytest
from moto.server import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import make_server

ENOUGH = 256 << 10  # bytes of one request or answer after which a cut falls in its middle


class S3Server:
    """moto, one request at a time: its conditional put is then as atomic as S3's."""

    def __init__(self) -> None:
        application = DomainDispatcherApplication(create_backend_app)
        self._server = make_server("127.0.0.1", 0, application, threaded=False)
        self.port = self._server.server_port
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()


class Network:
    """Forwards connections to a server, and cuts as many uploads or downloads in their middle as it is told to."""

    def __init__(self, port: int) -> None:
        self._target = port
        self.cut_uploads = self.cut_downloads = 0
        self.requests: list[str] = []
        self.heads: list[str] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(near,), daemon=True).start()

    def _serve(self, near: socket.socket) -> None:
        with near, socket.create_connection(("127.0.0.1", self._target)) as far:
            back = threading.Thread(target=self._pump, args=(far, near, self._download_is_cut, False), daemon=True)
            back.start()
            self._pump(near, far, self._upload_is_cut, True)
            back.join()

    def _pump(self, source: socket.socket, sink: socket.socket, cut: Callable[[], bool], first: bool) -> None:
        moved = 0
        try:
            while data := source.recv(1 << 16):
                if first and moved == 0:
                    head = data.partition(b"\r\n\r\n")[0].decode()
                    self.requests.append(" ".join(head.splitlines()[0].split()[:2]))
                    self.heads.append(head.lower())
                if moved <= ENOUGH < moved + len(data) and cut():
                    break
                moved += len(data)
                sink.sendall(data)
        except OSError:
            pass
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _upload_is_cut(self) -> bool:
        self.cut_uploads -= 1
        return self.cut_uploads >= 0

    def _download_is_cut(self) -> bool:
        self.cut_downloads -= 1
        return self.cut_downloads >= 0


def credentials(endpoint: str) -> dict[str, str]:
    """The environment that a client of the server needs."""
    assert urlparse(endpoint).hostname == "127.0.0.1"
    return {
        "AWS_ENDPOINT_URL": endpoint,
        "AWS_REGION": "us-east-1",
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
    }


@pytest.fixture(scope="session")
def network() -> Iterator[Network]:
    """An S3 server, reached over a network that can be cut."""
    server = S3Server()
    network = Network(server.port)
    yield network
    network.close()
    server.close()


@pytest.fixture
def bucket(network: Network, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> str:
    """A place in a bucket of that server, empty, and the environment that leads there."""
    for name, value in credentials(network.url).items():
        monkeypatch.setenv(name, value)
    client = boto3.client("s3", endpoint_url=network.url, region_name="us-east-1")
    client.create_bucket(Bucket="artifacts")
    client.close()
    network.cut_uploads = network.cut_downloads = 0
    network.heads.clear()
    return f"s3://artifacts/{abs(hash(request.node.nodeid))}"
