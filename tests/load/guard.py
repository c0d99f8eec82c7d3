#!/usr/bin/env python3
"""Row 15: one client that wants everything.

Each attack runs against a server of its own with default limits. Beside it an honest client, with
another key, asks for a dance of 4 s and for `/health`. Both must be answered: the dance within 3 s,
or with an honest 429. Memory stays within 1 GiB, and the server ends with 0.
"""

import contextlib
import http.client
import json
import socket
import struct
import threading
import time

from client import HOST, ask, dance_problem, hang_up
from harness import MIB, Server, Verdict, arguments, percentile
from songs import long_wav, mp3

GREEDY, HONEST = "greedy-" + "g" * 25, "honest-" + "h" * 25
SERVED_WITHIN = 3.0
MOST_MEMORY = 1024
PATIENCE = 30.0  # --answer-idle-timeout
RESET, PING, AWAY = 3, 6, 7


def key(name):
    return f"x-api-key: {name}"


def request(path):
    return f"GET {path} HTTP/1.1\r\nhost: {HOST}\r\n{key(GREEDY)}\r\n\r\n".encode()


class Http2:
    """As much of an HTTP/2 client as the attacks need: no header compression, pings answered."""

    def __init__(self, port, window):
        self.socket = socket.create_connection((HOST, port), 10)
        self.reset, self.alive, self.buffer, self.stream = set(), True, b"", 1
        window = struct.pack(">HI", 4, window)
        self.socket.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + self.frame(4, 0, 0, window))
        self.socket.setblocking(False)

    @staticmethod
    def frame(kind, flags, stream, payload=b""):
        return struct.pack(">I", len(payload))[1:] + bytes([kind, flags]) + struct.pack(
            ">I", stream
        ) + payload

    def ask(self, method, path, end=True):
        text = lambda value: bytes([len(value)]) + value.encode()
        block = {"GET": b"\x82", "POST": b"\x83"}[method] + b"\x86\x04" + text(path)
        block += b"\x01" + text("x") + b"\x00" + text("x-api-key") + text(GREEDY)
        self.send(self.frame(1, 5 if end else 4, self.stream, block))
        self.stream += 2
        return self.stream - 2

    def send(self, data):
        with contextlib.suppress(OSError):
            self.socket.sendall(data)

    def hear(self):
        """What has come meanwhile."""
        try:
            data = self.socket.recv(262_144)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self.alive &= bool(data)
        self.buffer += data
        while len(self.buffer) >= 9:
            length = int.from_bytes(self.buffer[:3], "big")
            if len(self.buffer) < 9 + length:
                return
            kind, flags = self.buffer[3], self.buffer[4]
            stream = int.from_bytes(self.buffer[5:9], "big")
            payload, self.buffer = self.buffer[9 : 9 + length], self.buffer[9 + length :]
            if kind == PING and not flags & 1:
                self.send(self.frame(PING, 1, 0, payload))
            elif kind == RESET:
                self.reset.add(stream)


class Honest(threading.Thread):
    """A client with a key of its own; it asks until it is told to stop."""

    def __init__(self, server):
        super().__init__(daemon=True)
        self.server, self.stopped = server, threading.Event()
        self.dances, self.probes, self.problems = [], [], []
        self.start()

    def run(self):
        while not self.stopped.wait(0.5):
            self.probes.append(self.server.get("/health", timeout=60).seconds)
            headers = [key(HONEST), "content-type: audio/mpeg"]
            reply = self.server.post("/generate?format=bvh", mp3(4), headers)
            if reply.status == 429 and reply.says_when_to_retry():
                continue
            problem = dance_problem(reply, is_bvh=True) if reply.status == 200 else reply.status
            self.dances.append(reply.seconds)
            if problem:
                self.problems.append(problem)

    def judge(self, verdict, name):
        self.stopped.set()
        self.join(180)
        verdict.problems(f"{name}: honest answers", self.problems)
        dance, probe = percentile(self.dances, 100), percentile(self.probes, 100)
        verdict.at_most(f"{name}: honest dance", dance, SERVED_WITHIN, "s", timed=True)
        verdict.at_most(f"{name}: /health", probe, 1.0, "s", timed=True)


def job(server, query, audio):
    """A job of the greedy client that is done; where its result is."""
    headers = [key(GREEDY), "content-type: application/octet-stream"]
    reply = server.post(f"/jobs?{query}", audio, headers)
    path = "/jobs/" + json.loads(reply.body)["id"]
    while json.loads(server.get(path, [key(GREEDY)]).body)["state"] != "done":
        time.sleep(0.3)
    return path + "/result"


def hung_up(server, seconds):
    """Results that nobody waits for."""
    result = job(server, "include=rotations&music=false", long_wav(seconds))
    for _ in range(40):
        connection = socket.create_connection((HOST, server.port))
        connection.sendall(request(result))
        time.sleep(0.008)
        hang_up(connection)


def readers(server, seconds):
    """Two hundred readers of one result who take nothing."""
    result = job(server, "include=rotations&music=false", long_wav(seconds))
    held = []
    for _ in range(200):
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        connection.connect((HOST, server.port))
        connection.sendall(request(result))
        held.append(connection)
    time.sleep(PATIENCE)
    return held


def windows(server, seconds):
    """Streams of which a byte is taken: reset in time, with all that was held for them."""
    result = job(server, "include=rotations&music=false", long_wav(seconds))
    clients = [Http2(server.port, 1) for _ in range(2)]
    for client in clients:
        for path in [result] * 9 + ["/api-doc/openapi.json"] * 9:
            client.ask("GET", path)
    until = time.monotonic() + PATIENCE + 10
    while time.monotonic() < until and any(len(client.reset) < 18 for client in clients):
        for client in clients:
            client.hear()
        time.sleep(0.05)
    held = server.metrics().sum("bailando_answer_bytes")
    assert held < 10e6, f"{held} bytes are held still"
    return clients


def idle(server, _):
    """More silent connections than there are places, and HTTP/2 ones that ask for nothing."""
    held = [Http2(server.port, 65_535) for _ in range(1030)]
    for _ in range(1000):
        connection = socket.socket()
        connection.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            connection.connect((HOST, server.port))
        held.append(connection)
    time.sleep(10)
    return held


def bodies(server, _):
    """As many bodies as there are places, each of which hardly moves."""
    clients = [Http2(server.port, 65_535) for _ in range(8)]
    streams = {}
    for client in clients:
        streams[client] = [client.ask("POST", "/generate", False) for _ in range(32)]
    until = time.monotonic() + 15
    while time.monotonic() < until:
        for client, mine in streams.items():
            for stream in mine:
                client.send(Http2.frame(0, 0, stream, b"\0"))
            client.hear()
        time.sleep(0.3)
    return clients


def jobs(server, seconds):
    """More jobs than are kept, each as heavy as can be."""
    headers = [key(GREEDY), "content-type: audio/wav"]
    statuses = [
        server.post("/jobs?candidates=16&music=false", long_wav(seconds), headers).status
        for _ in range(16)
    ]
    # As many jobs, and as many bytes, as one client may have.
    assert statuses.count(429) + statuses.count(503) >= 4, statuses
    reply = server.post("/jobs?duration_s=2", mp3(4), [key(HONEST), "content-type: audio/mpeg"])
    assert reply.status == 202, reply.error_type()
    time.sleep(10)


def heavy(server, seconds):
    """Long songs that take all rows of every step."""
    path = "/generate?music=false&candidates=16&window=sliding&redo=true"
    headers = [key(GREEDY), "content-type: audio/wav"]

    def order():
        # The server is ended before it is done.
        with contextlib.suppress(OSError, http.client.HTTPException):
            ask(server.port, "POST", path, long_wav(seconds), headers, 130)

    for _ in range(4):
        threading.Thread(target=order, daemon=True).start()
    time.sleep(25)


ATTACKS = [hung_up, readers, windows, idle, bodies, jobs, heavy]


def main():
    options = arguments(__doc__)
    verdict = Verdict(15, options.quick)
    seconds = 60 if options.quick else 300
    for attack in ATTACKS:
        name = attack.__name__
        keys = f"{GREEDY},{HONEST}"
        with Server(options, "--api-key", keys, "--max-jobs", 16) as server:
            honest = Honest(server)
            held = attack(server, seconds)
            honest.judge(verdict, name)
            verdict.at_most(f"{name}: peak of memory", server.peak_rss() / MIB, MOST_MEMORY, "MiB")
            del held
            if attack not in (jobs, heavy):
                server.stop(verdict)
    verdict.finish()


if __name__ == "__main__":
    main()
