#!/usr/bin/env python3
"""Row 8: clients that hang up during upload, in line, while their song is decoded and listened to,
while the model works, and in the midst of a stream.

After each of them every place is free within 1 s, by the gauges of /metrics, and the next request
gets its dance. How long the work went on is bailando_cancel_latency_seconds: in the model, no longer
than its slowest step. Half of the clients close their connection, half reset it.
"""

import json
import time
from collections import Counter

from client import connect, dance_problem, hang_up, head
from harness import Server, Verdict, arguments
from songs import mp3

FREE_WITHIN = 1.0
SONG_SECONDS = 590
GAUGES = ("bailando_requests_running", "bailando_queue_waiting", "bailando_uploads")
LATENCY = "bailando_cancel_latency_seconds"
STEP = "bailando_step_duration_seconds"
QUERY = "?format=bvh&music=true"
MEDIA = ["content-type: audio/mpeg"]


class Clients:
    """Sends what a phase needs, and hangs up; every second time abruptly."""

    def __init__(self, server):
        self.server, self.port = server, server.port
        self.song = mp3(SONG_SECONDS)
        self.turn = 0

    def hang_up(self, *connections):
        self.turn += 1
        for connection in connections:
            hang_up(connection, abruptly=self.turn % 2 == 0)

    def begin(self, path="/generate" + QUERY, song=None):
        """A connection that has sent a whole request."""
        song = song or self.song
        connection = connect(self.port)
        connection.sendall(head("POST", path, len(song), MEDIA) + song)
        return connection

    def upload(self):
        connection = connect(self.port)
        connection.sendall(head("POST", "/generate" + QUERY, len(self.song), MEDIA))
        connection.sendall(self.song[: len(self.song) // 2])
        wait_for(lambda: self.server.metrics().sum("bailando_uploads") == 1)
        self.hang_up(connection)

    def queue(self):
        """One works, and three in line behind it leave; then the one does."""
        working = self.begin()
        wait_for(lambda: self.server.metrics().sum("bailando_requests_running") == 1)
        waiting = [self.begin(song=mp3(5)) for _ in range(3)]
        wait_for(lambda: self.server.metrics().sum("bailando_queue_waiting") == 3)
        self.hang_up(*waiting)
        free = wait_for(lambda: self.server.metrics().sum("bailando_queue_waiting") == 0)
        self.hang_up(working)
        return free

    def at(self, delay):
        """Leaves so long after its whole song is there."""
        connection = self.begin()
        time.sleep(delay)
        self.hang_up(connection)

    def model(self, more):
        """Leaves after some steps of the model."""
        steps = self.server.metrics().sum(f"{STEP}_count")
        connection = self.begin()
        wait_for(lambda: self.server.metrics().sum(f"{STEP}_count") > steps + more)
        self.hang_up(connection)

    def stream(self):
        """Leaves after the first frames."""
        connection = self.begin("/generate/stream?include=rotations", mp3(60))
        heard = b""
        while b"event: frames" not in heard:
            data = connection.recv(65536)
            if not data:
                raise OSError(f"the stream ended: {heard[-200:]!r}")
            heard += data[-65536:]
        self.hang_up(connection)


def wait_for(condition, seconds=30):
    """How long it took; None if it did not happen."""
    started = time.monotonic()
    while time.monotonic() - started < seconds:
        if condition():
            return time.monotonic() - started
        time.sleep(0.01)
    return None


def stages(server, song):
    """When each stage of this song begins, by a job that tells: seconds after its order was sent."""
    started = time.monotonic()
    reply = server.post("/jobs" + QUERY, song, MEDIA)
    where, begins = reply.headers["location"], {}
    while time.monotonic() - started < 60 and "inference" not in begins:
        status = json.loads(server.get(where).body)
        if status["state"] in ("done", "failed"):
            break
        if stage := status.get("stage"):
            begins.setdefault(stage, time.monotonic() - started)
        time.sleep(0.005)
    with connect(server.port) as connection:
        connection.sendall(head("DELETE", where))
        connection.recv(1000)
    return begins


def cancelled(metrics):
    """Clients gone, by phase. A body that breaks off can be known as that, too."""
    gone = Counter(
        {labels["phase"]: int(count) for labels, count in metrics.of("bailando_cancelled_total")}
    )
    gone["upload"] += int(metrics.sum("bailando_rejected_total", reason="upload_broken"))
    return gone


class Trial:
    """One kind of disconnection, some times over."""

    def __init__(self, server, name):
        self.server, self.name = server, name
        self.free, self.problems = [], []
        self.before = server.metrics()

    def run(self, act, count):
        for number in range(count):
            try:
                freed = act(number)
            except OSError as broken:
                self.problems.append(f"{self.name}: {broken}")
                continue
            took = wait_for(
                lambda: not any(self.server.metrics().sum(gauge) for gauge in GAUGES), 20
            )
            self.free += [took] if freed is None else [freed, took]
            self.dance()

    def dance(self):
        """The next request works at once."""
        reply = self.server.post("/generate?format=bvh&candidates=1", mp3(2))
        problem = (
            f"{reply.status}: {reply.body[:100]!r}"
            if reply.status != 200
            else dance_problem(reply, True)
        )
        if problem:
            self.problems.append(f"after {self.name}: {problem}")

    def report(self, verdict):
        after = self.server.metrics()
        phases = cancelled(after) - cancelled(self.before)
        latency = after.largest_bucket(LATENCY, self.before)
        known = [took for took in self.free if took is not None]
        if len(known) < len(self.free) or not known:
            self.problems.append(f"{self.name}: places were not given back within 20 s")
        verdict.at_most(
            f"{self.name}: all places free, slowest of {len(self.free)}",
            max(known, default=None),
            FREE_WITHIN,
            "s",
            timed=True,
        )
        verdict.note(
            f"  counted by phase: {dict(phases)}; work ended within "
            f"{'-' if latency is None else f'{1000 * latency:g} ms'}"
        )
        return phases


def main():
    options = arguments(__doc__)
    verdict = Verdict(8, options.quick)
    count = 2 if options.quick else 10
    phases, problems = Counter(), []
    # One place to work in makes a line, and leaves no doubt about whose phase it is.
    with Server(options, "--max-concurrent-requests", 1) as server:
        clients = Clients(server)
        assert server.post("/generate?candidates=1", mp3(2)).status == 200
        begins = stages(server, clients.song)
        verdict.note(
            f"{SONG_SECONDS} s of mp3: stages begin after "
            + ", ".join(f"{stage} {1000 * at:.0f} ms" for stage, at in begins.items())
        )
        wait_for(lambda: not any(server.metrics().sum(gauge) for gauge in GAUGES))
        decode, listen, infer = (
            begins.get(stage, 0.5) for stage in ("decode", "features", "inference")
        )

        def between(start, end):
            return lambda number: clients.at(start + (end - start) * (0.2 + 0.6 * number / count))

        trials = {
            "upload": lambda _: clients.upload(),
            "line": lambda _: clients.queue(),
            "decoding": between(decode, listen),
            "features": between(listen, infer),
            "model": lambda number: clients.model(20 * number),
            "stream": lambda _: clients.stream(),
        }
        for name, act in trials.items():
            trial = Trial(server, name)
            trial.run(act, count)
            phases += trial.report(verdict)
            problems += trial.problems
            if name == "model":
                judge_step(verdict, server.metrics(), trial.before)
        verdict.note(f"counted in all: {dict(phases)}")
        for phase in ("upload", "queue", "decode", "inference"):
            verdict.at_least(f"clients gone in phase {phase}", phases[phase], 1)
        verdict.problems("requests that did not work, before or after", problems)
        server.stop(verdict)
    verdict.finish()


def judge_step(verdict, after, before):
    """Both are told by buckets, whose bounds double: work that ended within one step can be one bucket
    above it."""
    latency, step = after.largest_bucket(LATENCY, before), after.largest_bucket(STEP)
    if latency is None or step is None:
        verdict.check("model: end of work", "unknown", "counted in /metrics", False)
        return
    verdict.at_most("model: work ended within", 1000 * latency, 2000 * step, "ms", timed=True)
    verdict.note(f"  the slowest step took at most {1000 * step:g} ms")


if __name__ == "__main__":
    main()
