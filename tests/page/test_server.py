"""Who may ask the page's server, and what it reads of what it is sent."""

import http.client
import json
import socket
import struct
import threading
import time

import pytest

from inpaint3d.contracts.kit.page_server import (
    HEADERS,
    MAX_BODY_BYTES,
    MAX_CONNECTIONS,
    MAX_PICTURE_BYTES,
    Answer,
    PageServer,
    answer_json,
)


def get(path):
    return Answer(f"[{path}]".encode(), "text/plain")


def put(path, picture):
    return answer_json({"path": path, "bytes": len(picture)})


def post(path, value):
    return answer_json({"path": path, "value": value})


@pytest.fixture
def server():
    with PageServer(get, post, put=put) as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def ask(server, path="", method="GET", body=None, **headers):
    """Status, headers and body of an answer; `headers` replace those of a request that is right."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    sent = {"Host": f"127.0.0.1:{server.server_port}"}
    if body is not None:
        sent |= {"Content-Type": "application/json", "Content-Length": str(len(body))}
    sent |= {name.replace("_", "-"): value for name, value in headers.items()}
    connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
    for name, value in sent.items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders(body)
    response = connection.getresponse()
    answer = response.status, dict(response.getheaders()), response.read()
    connection.close()
    return answer


def test_whoever_knows_the_token_is_answered_on_the_loopback_address_alone(server):
    status, headers, body = ask(server, f"/{server.token}/frames/a.jpg")
    assert (status, body) == (200, b"[frames/a.jpg]")
    assert HEADERS.items() <= headers.items()
    assert "'unsafe" not in headers["Content-Security-Policy"]
    assert server.server_address[0] == "127.0.0.1"
    assert ask(server, f"/{server.token}/", Host=f"localhost:{server.server_port}")[0] == 200


@pytest.mark.parametrize("path", ["/", "/scene", "/TOKEN", "//TOKEN/scene", "/TOKENx/scene", "/%C3%A9/scene", "x"])
def test_without_the_token_nothing_is_told(server, path):
    if path != "/TOKEN":
        path = path.replace("TOKEN", server.token[:-1])
    status, headers, body = ask(server, path)
    assert status == 403
    assert b"[" not in body
    assert headers["Content-Security-Policy"] == HEADERS["Content-Security-Policy"]


@pytest.mark.parametrize("host", [None, "evil.example", "evil.example:PORT", "127.0.0.1", "127.0.0.1:1", "[::1]:PORT"])
def test_a_name_that_is_not_its_own_is_refused(server, host):
    given = host and host.replace("PORT", str(server.server_port))
    assert ask(server, f"/{server.token}/", Host=given)[0] == 403


def test_two_names_are_refused(server):
    lines = f"GET /{server.token}/ HTTP/1.1\r\nHost: 127.0.0.1:{server.server_port}\r\nHost: evil.example\r\n\r\n"
    with socket.create_connection(server.server_address) as connection:
        connection.sendall(lines.encode())
        assert b" 403 " in connection.recv(100)


@pytest.mark.parametrize("origin", ["https://evil.example", "null", "http://127.0.0.1:1"])
def test_another_sites_page_is_refused(server, origin):
    assert ask(server, f"/{server.token}/save", "POST", b"{}", Origin=origin)[0] == 403


def test_the_pages_own_questions_are_answered(server):
    own = f"http://127.0.0.1:{server.server_port}"
    status, _, body = ask(server, f"/{server.token}/save", "POST", b'{"a": [1]}', Origin=own)
    assert (status, json.loads(body)) == (200, {"path": "save", "value": {"a": [1]}})


@pytest.mark.parametrize(
    ("body", "headers", "status"),
    [
        (b"x" * 10, {"Content_Length": str(MAX_BODY_BYTES + 1)}, 413),
        (b"{}", {"Content_Length": None}, 411),
        (b"{}", {"Content_Length": "-2"}, 411),
        (b"{}", {"Content_Length": "2e0"}, 411),
        (b"{}", {"Transfer_Encoding": "chunked"}, 411),
        (b"{}", {"Content_Type": "text/plain"}, 415),
        (b"{}", {"Content_Type": None}, 415),
        (b"{", {}, 400),
        (b"\xff\xfe", {}, 400),
        (b"[" * 100_000, {}, 400),
        (b"1" * 10_000, {}, 400),
    ],
)
def test_what_is_sent_is_read_within_bounds(server, body, headers, status):
    found, answered, _ = ask(server, f"/{server.token}/save", "POST", body, **headers)
    assert found == status
    assert answered["Connection"] == "close"


def test_less_than_was_announced_is_refused(server):
    own = f"127.0.0.1:{server.server_port}"
    lines = f"POST /{server.token}/save HTTP/1.1\r\nHost: {own}\r\nContent-Type: application/json\r\n"
    with socket.create_connection(server.server_address) as connection:
        connection.sendall(f"{lines}Content-Length: 9\r\n\r\n{{}}".encode())
        connection.shutdown(socket.SHUT_WR)
        assert b" 400 " in connection.recv(100)


def test_a_picture_is_taken_by_its_kind_and_within_bounds(server):
    def put_it(body, **headers):
        return ask(server, f"/{server.token}/painted/a.png", "PUT", body, **headers)

    status, _, body = put_it(b"12345", Content_Type="image/png")
    assert (status, json.loads(body)) == (200, {"path": "painted/a.png", "bytes": 5})
    assert put_it(b"12345", Content_Type="text/plain")[0] == 415
    assert put_it(b"", Content_Type="image/tiff", Content_Length=str(MAX_PICTURE_BYTES + 1))[0] == 413
    assert put_it(b"12345", Content_Type="image/png", Origin="http://elsewhere.example")[0] == 403


@pytest.mark.parametrize("method", ["DELETE", "OPTIONS", "HEAD"])
def test_other_methods_are_refused_under_the_same_policy(server, method):
    status, headers, _ = ask(server, f"/{server.token}/", method)
    assert status == 501
    assert HEADERS.items() <= headers.items()


def test_nothing_that_holds_the_token_is_written(server, capfd):
    ask(server, f"/{server.token}/")
    ask(server, f"/{server.token}/", "PUT")
    said = capfd.readouterr()
    assert server.token not in said.out + said.err


def test_who_goes_away_in_the_middle_is_no_error(server, capfd):
    with socket.create_connection(server.server_address) as connection:
        connection.sendall(b"GET / HT")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # no farewell: a reset
    assert is_answered(server)
    assert capfd.readouterr().err == ""


def is_answered(server):
    try:
        return ask(server, f"/{server.token}/")[0] == 200
    except (ConnectionError, http.client.BadStatusLine):
        return False


def test_above_its_limit_connections_are_closed_and_below_it_answered_again(server):
    line = f"GET /{server.token}/ HTTP/1.1\r\nHost: 127.0.0.1:{server.server_port}\r\n\r\n"
    held = [socket.create_connection(server.server_address) for _ in range(MAX_CONNECTIONS)]
    for connection in held:  # answered, and kept open
        connection.sendall(line.encode())
        assert b" 200 " in connection.recv(100)
    assert not is_answered(server)
    for connection in held:
        connection.close()
    until = time.monotonic() + 10
    while not (again := is_answered(server)) and time.monotonic() < until:
        time.sleep(0.01)  # their threads have yet to notice
    assert again
