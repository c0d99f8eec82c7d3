"""HTTP by sockets, so that a test can send what no client would, and hang up when it likes."""

import contextlib
import http.client
import json
import re
import socket
import struct
import time
from dataclasses import dataclass

HOST = "127.0.0.1"
ERROR_KEYS = {"error", "error_type", "request_id"}


@dataclass
class Reply:
    """An answer, received whole."""

    status: int
    headers: dict
    body: bytes
    seconds: float

    def is_error_shape(self):
        try:
            body = json.loads(self.body)
        except ValueError:
            return False
        return (
            isinstance(body, dict)
            and set(body) == ERROR_KEYS
            and all(isinstance(value, str) and value for value in body.values())
        )

    def error_type(self):
        return json.loads(self.body)["error_type"] if self.is_error_shape() else None

    def says_when_to_retry(self):
        return (
            self.headers.get("retry-after", "").isdigit() and int(self.headers["retry-after"]) >= 1
        )

    def refusal_problem(self):
        """What is wrong with it as a refusal; None where all is well."""
        if not self.is_error_shape():
            return f"{self.status} in another shape than ours: {self.body[:100]!r}"
        if self.status in (429, 503) and not self.says_when_to_retry():
            return f"{self.status} {self.error_type()} without Retry-After"
        return None


def connect(port, timeout=30):
    return socket.create_connection((HOST, port), timeout)


def head(method, path, length=None, headers=()):
    """The head of a request, for one connection alone."""
    lines = [f"{method} {path} HTTP/1.1", "host: localhost", "connection: close", *headers]
    if length is not None:
        lines.append(f"content-length: {length}")
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


def read_reply(connection, method="GET", started=None):
    """The answer; OSError or HTTPException if it breaks off."""
    response = http.client.HTTPResponse(connection, method=method)
    response.begin()
    body = response.read()
    headers = {name.lower(): value for name, value in response.getheaders()}
    seconds = time.monotonic() - started if started is not None else 0.0
    return Reply(response.status, headers, body, seconds)


def ask(port, method, path, body=None, headers=(), timeout=30):
    """One request on a connection of its own."""
    started = time.monotonic()
    with connect(port, timeout) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # A server may answer and hang up before it has read everything: the answer counts.
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            connection.sendall(head(method, path, None if body is None else len(body), headers))
            if body:
                connection.sendall(body)
        return read_reply(connection, method, started)


def hang_up(connection, abruptly=True):
    """Closes a connection; abruptly with a reset, as a process that is killed with data unread."""
    if abruptly:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def form(audio, name="song.mp3", **fields):
    """A multipart body with a song and options, and its content type as a header line."""
    boundary = "a-boundary-that-no-song-holds"
    parts = [
        f'--{boundary}\r\ncontent-disposition: form-data; name="{field}"\r\n\r\n{value}\r\n'.encode()
        for field, value in fields.items()
    ]
    parts.append(
        f'--{boundary}\r\ncontent-disposition: form-data; name="file"; filename="{name}"\r\n'
        "content-type: application/octet-stream\r\n\r\n".encode()
        + audio
        + b"\r\n"
    )
    parts.append(f"--{boundary}--\r\n".encode())
    return b"".join(parts), f"content-type: multipart/form-data; boundary={boundary}"


# Whole answers.


def dance_problem(reply, is_bvh=False):
    """What is missing from a dance; None if it is whole."""
    try:
        if is_bvh:
            text = reply.body.decode()
            frames = int(re.search(r"^Frames: (\d+)$", text, re.MULTILINE)[1])
            rows = text.partition("Frame Time:")[2].count("\n") - 1
            return None if frames > 0 and rows == frames else f"{rows} rows, says {frames} frames"
        dance = json.loads(reply.body)
        rows = len(dance["positions"])
        return (
            None if rows == dance["frames"] > 0 else f"{rows} poses, says {dance['frames']} frames"
        )
    except (ValueError, KeyError, TypeError) as problem:
        return f"no dance: {problem!r}"


def events(body, lines=False):
    """The events of a stream's answer: their names and objects."""
    if lines:
        objects = [json.loads(line) for line in body.decode().splitlines() if line.strip()]
        return [(event["event"], event) for event in objects]
    result = []
    for block in body.decode().split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.splitlines() if ": " in line)
        if "event" in fields:
            result.append((fields["event"], json.loads(fields["data"])))
    return result


def stream_problem(reply, lines=False):
    """What is missing from a stream; None if it is whole."""
    try:
        parts = events(reply.body, lines)
        names = [name for name, _ in parts]
        if names[:1] != ["start"] or names[-1:] != ["done"] or set(names[1:-1]) > {"frames"}:
            return f"events {names[:1]} .. {names[-1:]}: {str(parts[-1:])[:200]}"
        sent = sum(event["count"] for name, event in parts if name == "frames")
        said = parts[0][1]["frames"]
        return None if sent == said == parts[-1][1]["frames"] else f"{sent} frames, says {said}"
    except (ValueError, KeyError, TypeError) as problem:
        return f"no stream: {problem!r}"
