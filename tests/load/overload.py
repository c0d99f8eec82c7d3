#!/usr/bin/env python3
"""Row 6: ten times more requests than the server can do.

First the most that it can do: `hey` in a closed loop, twice as many clients as places to work in.
Then ten times that many requests a second, from far more clients than may run and wait. Meanwhile
/health is asked every 20 ms on a new connection, and a sampler reads whole answers, which hey does
not. Asked for: no answers but 200, 429 and 503; Retry-After on every 429 and 503; at least 90 % of
the peak's dances a second; p99 of /health at most 50 ms.

hey shares the processors with the server: it runs niced, and its share is told.
"""

import http.client
import math
import multiprocessing
import os
import re
import resource
import subprocess
import threading
import time
from collections import Counter

from client import ask
from harness import (
    Server,
    Verdict,
    arguments,
    die_with_parent,
    need_hey,
    percentile,
    scratch,
    spawn,
    times,
)
from songs import mp3

TIMES_CAPACITY = 10
LEAST_GOODPUT = 0.9
SLOWEST_HEALTH = 0.05
PROBE_EVERY = 0.02
SAMPLE_EVERY = 0.25
ROUTE = "/generate?format=bvh&candidates=1"
SONG_SECONDS = 5
# The first seconds of a phase are left out: the line fills, hey starts.
WARM_UP = 5


def hey(server, seconds, clients, per_second=None):
    """A running hey: so many clients, each in a closed loop or with its share of the rate."""
    song = scratch() / "song.mp3"
    song.write_bytes(mp3(SONG_SECONDS))
    command = [
        "nice",
        "-n",
        "10",
        need_hey(),
        "-z",
        f"{seconds}s",
        "-c",
        str(clients),
        "-t",
        "130",
        "-m",
        "POST",
        "-T",
        "audio/mpeg",
        "-D",
        str(song),
    ]
    if per_second:
        command += ["-q", f"{per_second / clients:.6f}"]
    url = f"http://127.0.0.1:{server.port}{ROUTE}"
    return spawn([*command, url], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def read_report(text):
    """Answers by status, and what hey calls errors."""
    statuses = {
        int(code): int(count)
        for code, count in re.findall(r"^\s*\[(\d{3})\]\s+(\d+) responses", text, re.M)
    }
    errors = text.partition("Error distribution:")[2].strip()
    return statuses, errors


class Phase:
    """hey for some seconds, and what the server's own counters say of the time without the warm-up."""

    def __init__(self, server, seconds, clients, per_second=None, warm_up=WARM_UP):
        cpu, wall = _children_cpu(), time.monotonic()
        process = hey(server, seconds, clients, per_second)
        time.sleep(warm_up)
        before, began = server.metrics(), time.monotonic()
        served = server.cpu_seconds()
        time.sleep(seconds - warm_up)
        after, ended = server.metrics(), time.monotonic()
        self.server_cpu = (server.cpu_seconds() - served) / (ended - began)
        report, _ = process.communicate(timeout=200)
        wall = time.monotonic() - wall
        # hey is the only child that has been waited for.
        self.share = (_children_cpu() - cpu) / (wall * os.cpu_count())
        self.statuses, self.errors = read_report(report)
        self.report = report

        def rate(**labels):
            route = {"route": "/generate", **labels}
            name = "bailando_http_requests_total"
            return (after.sum(name, **route) - before.sum(name, **route)) / (ended - began)

        self.goodput, self.answered = rate(status="200"), rate()

    def describe(self):
        return (
            f"{self.goodput:.2f} dances/s, {self.answered:.1f} answers/s; {dict(sorted(self.statuses.items()))}; "
            f"of all processors hey took {100 * self.share:.1f} %, "
            f"the server {100 * self.server_cpu / os.cpu_count():.0f} %"
        )


def _children_cpu():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def probe(port, stop, results):
    """Asks /health on a new connection every 20 ms; in a process of its own, for the times' sake."""
    die_with_parent()
    since_due, since_asked, problems = [], [], []
    due = time.monotonic()
    while not stop.is_set():
        try:
            reply = ask(port, "GET", "/health", timeout=10)
            # A probe that could not start when it was due, because the one before hung, has waited too.
            since_due.append(time.monotonic() - due)
            since_asked.append(reply.seconds)
            if reply.status != 200:
                problems.append(f"/health: {reply.status}")
        except (OSError, http.client.HTTPException) as broken:
            problems.append(f"/health: {type(broken).__name__}: {broken}")
        due += PROBE_EVERY
        time.sleep(max(0.0, due - time.monotonic()))
    results.send((since_due, since_asked, problems))


class Sampler(threading.Thread):
    """Reads whole answers of the overloaded server, four times a second."""

    def __init__(self, port):
        super().__init__(daemon=True)
        self.port, self.stopped = port, threading.Event()
        self.statuses, self.problems, self.waits = Counter(), [], []
        self.askers = []

    def run(self):
        while not self.stopped.wait(SAMPLE_EVERY):
            asker = threading.Thread(target=self.sample, daemon=True)
            self.askers.append(asker)
            asker.start()

    def sample(self):
        try:
            reply = ask(
                self.port,
                "POST",
                ROUTE,
                mp3(SONG_SECONDS),
                ["content-type: audio/mpeg"],
                timeout=150,
            )
        except Exception as broken:
            self.problems.append(f"{type(broken).__name__}: {broken}")
            return
        self.statuses[reply.status] += 1
        if reply.status not in (200, 429, 503):
            self.problems.append(f"status {reply.status}: {reply.body[:100]!r}")
        elif reply.status != 200:
            if problem := reply.refusal_problem():
                self.problems.append(problem)
            else:
                self.waits.append(int(reply.headers["retry-after"]))

    def finish(self):
        self.stopped.set()
        self.join()
        for asker in self.askers:
            asker.join(160)


class Prober:
    """`probe` in a process of its own, while something is measured."""

    def __init__(self, port):
        context = multiprocessing.get_context("fork")
        self.stop, (self.results, ours) = context.Event(), context.Pipe()
        process = context.Process(target=probe, args=(port, self.stop, ours), daemon=True)
        process.start()

    def finish(self):
        self.stop.set()
        return self.results.recv()


def peak_phase(server, quick, clients):
    """The most dances a second, with the same onlooker as under overload."""
    prober = Prober(server.port)
    try:
        return Phase(server, 8 if quick else 30, clients, warm_up=3 if quick else WARM_UP)
    finally:
        prober.finish()


def overload(server, verdict, seconds, peak, clients_at_peak, limits):
    running_and_waiting = limits["max_concurrent_requests"] + limits["queue"]
    # Those in line ask for nothing new; the others must make up the rate.
    clients = running_and_waiting + 200
    per_second = TIMES_CAPACITY * peak * clients / (clients - running_and_waiting)
    mp3(SONG_SECONDS)
    prober = Prober(server.port)
    sampler = Sampler(server.port)
    sampler.start()
    try:
        phase = Phase(server, seconds, clients, per_second)
    finally:
        health, asked, problems = prober.finish()
    sampler.finish()
    # The machine's own pace drifts: the peak is that before and that after.
    later = peak_phase(server, verdict.quick, clients_at_peak)
    verdict.note(f"peak, afterwards: {later.describe()}")
    peak = (peak + later.goodput) / 2
    verdict.note(f"overload: {phase.describe()}")
    verdict.at_least(
        "answers a second by the peak's dances",
        phase.answered / peak,
        0.9 * TIMES_CAPACITY,
        "times",
        timed=True,
    )
    others = {
        status: count for status, count in phase.statuses.items() if status not in (200, 429, 503)
    }
    verdict.equal("answers other than 200, 429, 503", sum(others.values()), 0)
    verdict.check("requests without an answer", phase.errors or 0, "must be 0", not phase.errors)
    verdict.note(
        f"sampler: {dict(sampler.statuses)}, Retry-After from {min(sampler.waits, default='-')} "
        f"to {max(sampler.waits, default='-')} s"
    )
    verdict.problems(
        "sampled answers that are wrong, as a refusal without Retry-After", sampler.problems
    )
    verdict.at_least("sampled refusals", len(sampler.waits), 10 if verdict.quick else 100)
    verdict.at_least(
        "dances a second by the peak's", phase.goodput / peak, LEAST_GOODPUT, timed=True
    )
    verdict.note(f"/health, from when it was due: {times(health)}")
    verdict.note(f"/health, from when it was asked: {times(asked)}")
    verdict.problems("/health not answered with 200", problems)
    verdict.at_most(
        "p99 of /health", 1000 * percentile(health, 99), 1000 * SLOWEST_HEALTH, "ms", timed=True
    )


def main():
    def extend(parser):
        parser.add_argument("--seconds", type=int, help="how long the overload lasts [default: 60]")

    options = arguments(__doc__, extend)
    need_hey()
    verdict = Verdict(6, options.quick)
    with Server(options) as server:
        limits = server.limits()
        assert server.post(ROUTE, mp3(SONG_SECONDS)).status == 200
        clients = 2 * limits["max_concurrent_requests"]
        peak = peak_phase(server, options.quick, clients)
        verdict.note(f"peak, {clients} clients: {peak.describe()}")
        if verdict.at_least("dances a second at the peak", peak.goodput, 0.1) and math.isfinite(
            peak.goodput
        ):
            seconds = options.seconds or (12 if options.quick else 60)
            overload(server, verdict, seconds, peak.goodput, clients, limits)
        server.stop(verdict)
    verdict.finish()


if __name__ == "__main__":
    main()
