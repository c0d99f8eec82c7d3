#!/usr/bin/env python3
"""Row 14: half an hour of everything.

Songs of 5 to 60 s as mp3, wav, ogg, flac and m4a; whole dances in both formats, streams of both
kinds, jobs that are fetched, deleted or forgotten; errors; clients that hang up. Every 5 s memory,
file descriptors and threads are read, and every two minutes all clients wait until the server has nothing to do.
After the first third memory at rest may rise by 1 MiB an hour at most (a straight line through the
readings: those under load move by what is being worked on, which hides so small a slope), and
descriptors and threads stay within bounds; at the end, at rest, they are what they were before.
"""

import csv
import http.client
import io
import json
import random
import threading
import time
from collections import Counter

from client import ask, connect, dance_problem, form, hang_up, head, stream_problem
from harness import MIB, Server, Verdict, arguments, keep, times
from songs import MEDIA, fixture, long_wav, mp3

CLIENTS = 4
EVERY = 5.0
STEEPEST = 1.0
# What clients that come and go may add at one moment: a connection each, and that of a hang-up that
# the server has not seen yet.
MORE_DESCRIPTORS = 2 * CLIENTS + 8
# Threads for blocking work come with the work and go after 10 s without.
MORE_THREADS = 3 * CLIENTS + 4
# Forgotten jobs go after so long: a rest is longer, so that nothing of them is left.
JOB_TTL = 20
# From one rest to the next, and how long one is.
REST_EVERY = 120.0
REST = 35.0
LENGTHS = [5, 8, 13, 20, 30, 45, 60]
LINES = "accept: application/x-ndjson"


def song(noise):
    """A song, its media type, and the options that make it as long as drawn."""
    ending, length = noise.choice(list(MEDIA)), noise.choice(LENGTHS)
    if ending == "mp3":
        return mp3(length), ending, ""
    if ending == "wav":
        return long_wav(length), ending, ""
    # Of these there is one of 30 s: longer ones would need a codec.
    return fixture(f"demo.{ending}"), ending, f"&duration_s={min(length, 30)}"


class Client(threading.Thread):
    """Does one thing after another until told to stop."""

    def __init__(self, server, seed, stop, work):
        super().__init__(daemon=True)
        self.port, self.noise, self.stop = server.port, random.Random(seed), stop
        # `work` is set while there is to be any; between two acts `resting` is.
        self.work, self.resting = work, threading.Event()
        self.done, self.problems, self.seconds = Counter(), [], []

    def run(self):
        acts = (
            [self.dance] * 6
            + [self.stream] * 4
            + [self.job] * 3
            + [self.mistake] * 3
            + [self.leave] * 2
        )
        while not self.stop.is_set():
            self.resting.set()
            self.work.wait()
            self.resting.clear()
            act = self.noise.choice(acts)
            try:
                problem = act()
            except (OSError, http.client.HTTPException, ValueError, KeyError) as broken:
                problem = f"{type(broken).__name__}: {broken}"
            self.done[act.__name__] += 1
            if problem:
                self.problems.append(f"{act.__name__}: {problem}")

    def post(self, path, headers=()):
        """A whole request; its options are drawn."""
        audio, ending, options = song(self.noise)
        path += f"?seed={self.noise.randrange(1000)}{options}"
        path += self.noise.choice(["", "&candidates=1", "&candidates=1", "&fps=30&candidates=1"])
        body, media = audio, f"content-type: {MEDIA[ending]}"
        if self.noise.random() < 0.5:
            body, media = form(audio, f"song.{ending}")
        return ask(self.port, "POST", path, body, [media, *headers], timeout=150)

    def dance(self):
        accept = self.noise.choice(["application/x-bvh", "application/json"])
        reply = self.post("/generate", [f"accept: {accept}"])
        if reply.status != 200:
            return f"status {reply.status}: {reply.body[:200]!r}"
        self.seconds.append(reply.seconds)
        return dance_problem(reply, is_bvh="bvh" in accept)

    def stream(self):
        lines = self.noise.random() < 0.5
        reply = self.post("/generate/stream", [LINES] if lines else [])
        return stream_problem(reply, lines) if reply.status == 200 else f"status {reply.status}"

    def job(self):
        reply = self.post("/jobs")
        if reply.status == 429:
            # Forgotten ones are kept for a while.
            return reply.refusal_problem()
        if reply.status != 202:
            return f"status {reply.status}"
        where, fate = (
            reply.headers["location"],
            self.noise.choice(["fetch", "fetch", "fetch", "delete", "forget"]),
        )
        if fate == "fetch":
            problem = self.fetch(where)
            if problem:
                return problem
        if fate != "forget":
            status = ask(self.port, "DELETE", where).status
            return None if status == 204 else f"DELETE: {status}"
        return None

    def fetch(self, where):
        until = time.monotonic() + 120
        while time.monotonic() < until:
            state = json.loads(ask(self.port, "GET", where).body)["state"]
            if state == "done":
                bvh = self.noise.random() < 0.5
                reply = ask(
                    self.port,
                    "GET",
                    f"{where}/result?format={'bvh' if bvh else 'json'}",
                    timeout=60,
                )
                return dance_problem(reply, bvh)
            if state == "failed":
                return "failed"
            time.sleep(0.2)
        return "not done within 120 s"

    def mistake(self):
        """Something that is refused."""
        song = mp3(8)
        wrong = [
            ("POST", "/generate?fps=25", song, {400}),
            ("POST", "/generate", b"", {400}),
            ("POST", "/generate", b"la la la" * 100, {415}),
            ("POST", "/generate", self.noise.randbytes(20_000), {415, 422}),
            ("POST", "/generate", fixture("demo.flac")[:100], {422}),
            ("POST", "/generate/stream?format=bvh", song, {400}),
            ("POST", "/jobs?temperature=-1", song, {400}),
            ("POST", "/nowhere", song, {404}),
            ("GET", "/generate", None, {405}),
            ("GET", f"/jobs/{self.noise.randrange(100)}", None, {404}),
            ("GET", "/codes/100000/0", None, {400}),
        ]
        method, path, body, statuses = self.noise.choice(wrong)
        reply = ask(
            self.port,
            method,
            path,
            body,
            ["content-type: application/octet-stream"] if body is not None else [],
        )
        return (
            None if reply.status in statuses else f"{method} {path}: {reply.status}, not {statuses}"
        )

    def leave(self):
        """Hangs up somewhere between the first byte and the answer."""
        audio, ending, options = song(self.noise)
        path = self.noise.choice(["/generate", "/generate/stream", "/jobs"])
        request = (
            head(
                "POST",
                f"{path}?candidates=1{options}",
                len(audio),
                [f"content-type: {MEDIA[ending]}"],
            )
            + audio
        )
        sent = self.noise.choice([10, len(request) // 2, len(request), len(request), len(request)])
        connection = connect(self.port)
        connection.sendall(request[:sent])
        time.sleep(self.noise.uniform(0, 0.5))
        hang_up(connection, self.noise.random() < 0.5)


def line(readings):
    """Slope of the straight line through (hours, value) with its standard error."""
    count = len(readings)
    if count < 3:
        return float("nan"), float("nan")
    mean_x = sum(x for x, _ in readings) / count
    mean_y = sum(y for _, y in readings) / count
    spread = sum((x - mean_x) ** 2 for x, _ in readings)
    slope = sum((x - mean_x) * (y - mean_y) for x, y in readings) / spread
    rest = sum((y - mean_y - slope * (x - mean_x)) ** 2 for x, y in readings)
    return slope, (rest / (count - 2) / spread) ** 0.5


def at_rest(server, seconds=14):
    """Descriptors and threads once nothing has happened for a while."""
    time.sleep(seconds)
    return server.descriptors(), server.threads(), server.rss()


def soak(server, seconds, seed):
    """Readings (seconds, memory, descriptors, threads), memory at rest (seconds, memory), and the clients."""
    stop, work = threading.Event(), threading.Event()
    work.set()
    clients = [Client(server, f"{seed} {number}", stop, work) for number in range(CLIENTS)]
    for client in clients:
        client.start()
    started, readings, rests = time.monotonic(), [], []
    try:
        while (now := time.monotonic() - started) < seconds and server.is_alive():
            readings.append((now, server.rss(), server.descriptors(), server.threads()))
            if len(readings) % 60 == 1:
                print(
                    f"row 14: {now / 60:.0f} min: {readings[-1][1] / MIB:.1f} MiB, {readings[-1][2]} descriptors, "
                    f"{readings[-1][3]} threads, {sum(sum(client.done.values()) for client in clients)} acts"
                )
            if now >= REST_EVERY * (len(rests) + 1):
                rests.append((time.monotonic() - started, rest(server, clients, work)))
            time.sleep(max(0.0, EVERY - (time.monotonic() - started - now)))
    finally:
        stop.set()
    for client in clients:
        client.join(200)
    return readings, rests, clients


def rest(server, clients, work):
    """Memory while all clients wait."""
    work.clear()
    for client in clients:
        client.resting.wait(200)
    # The lowest reading: the allocator gives back little by little.
    memory = []
    until = time.monotonic() + REST
    while time.monotonic() < until:
        memory.append(server.rss())
        time.sleep(1)
    work.set()
    return min(memory)


def report(verdict, readings, rests, clients):
    done = sum((client.done for client in clients), Counter())
    verdict.note(
        f"done: {dict(done)}; dances: {times([second for client in clients for second in client.seconds])}"
    )
    verdict.problems(
        "answers that were wrong",
        [problem for client in clients for problem in client.problems],
        shown=10,
    )
    first = readings[-1][0] / 3
    late = [reading for reading in readings if reading[0] >= first]
    memory = [(at / 3600, rss / MIB) for at, rss, _, _ in late]
    slope, error = line(memory)
    verdict.note(
        f"memory after the first third: {min(y for _, y in memory):.1f} to {max(y for _, y in memory):.1f} MiB, "
        f"{len(memory)} readings; slope {slope:+.2f} MiB/h, standard error {error:.2f} (as if independent)"
    )
    calm = [(at / 3600, rss / MIB) for at, rss in rests if at >= first]
    slope, error = line(calm)
    verdict.note(
        f"memory at rest since then: {', '.join(f'{y:.1f}' for _, y in calm)} MiB; standard error of the slope {error:.2f}"
    )
    verdict.at_most("slope of memory at rest", slope, STEEPEST, "MiB/h", timed=True)
    for name, column, most in (("descriptors", 2, MORE_DESCRIPTORS), ("threads", 3, MORE_THREADS)):
        values = [reading[column] for reading in late]
        verdict.at_most(
            f"{name}, highest less lowest ({min(values)} to {max(values)})",
            max(values) - min(values),
            most,
        )


def write(readings):
    table = io.StringIO()
    rows = csv.writer(table)
    rows.writerow(["seconds", "rss_bytes", "descriptors", "threads"])
    rows.writerows((f"{at:.1f}", *rest) for at, *rest in readings)
    return keep("soak.csv", table.getvalue().encode())


def main():
    def extend(parser):
        parser.add_argument("--minutes", type=float, help="how long [default: 30]")
        parser.add_argument("--seed", type=int, default=1)

    options = arguments(__doc__, extend)
    verdict = Verdict(14, options.quick)
    minutes = options.minutes or (1 if options.quick else 30)
    with Server(options, "--job-ttl", JOB_TTL) as server:
        # Each kind of work has been done once before anything is compared.
        warm = [Client(server, seed, threading.Event(), threading.Event()) for seed in range(2)]
        for client in warm:
            for act in (client.dance, client.stream, client.job, client.leave):
                act()
        before = at_rest(server)
        readings, rests, clients = soak(server, 60 * minutes, options.seed)
        verdict.note(f"readings: {write(readings)}")
        report(verdict, readings, rests, clients)
        if server.is_alive():
            after = at_rest(server)
            verdict.at_most("descriptors at rest, more than before", after[0] - before[0], 2)
            verdict.at_most("threads at rest, more than before", after[1] - before[1], 2)
            verdict.note(
                f"memory at rest: {before[2] / MIB:.1f} MiB before, {after[2] / MIB:.1f} MiB after"
            )
            panics = server.metrics().sum("bailando_panics_total")
            verdict.equal("panics caught", int(panics), 0)
        server.stop(verdict)
    verdict.finish()


if __name__ == "__main__":
    main()
