#!/usr/bin/env python3
"""Row 7: SIGTERM under load, 20 times.

Each time a server of its own works on whole dances, streams and jobs when it is told to stop.
What it had accepted must end whole: dances parse, streams end with `done`, jobs are done and their
results are fetched by clients that go on asking. /ready must say 503 within 100 ms while the work
goes on, and the exit code must be 0 before the drain deadline.

Accepted is whatever is not refused: a whole 429 or 503, or, for what is sent after the signal, a
connection that is refused or closed before any of an answer.
"""

import http.client
import json
import random
import threading
import time
from collections import Counter

from client import ask, dance_problem, form, stream_problem
from harness import Server, Verdict, arguments, percentile, times
from songs import mp3

READY_WITHIN = 0.1
DANCERS, STREAMERS, ORDERERS = 4, 4, 3
BROKEN = (OSError, http.client.HTTPException)
LINES = "accept: application/x-ndjson"


class Load:
    """Clients of one server, from their start until each has ended what it had begun."""

    def __init__(self, server, seed):
        self.server, self.port = server, server.port
        self.told = None
        self.ended = threading.Event()
        self.lock = threading.Lock()
        self.outcomes, self.lost = Counter(), []
        self.threads = [
            threading.Thread(
                target=self.loop,
                args=(client, random.Random(f"{seed} {kind} {number}")),
                daemon=True,
            )
            for kind, client, count in (
                ("dance", self.dance, DANCERS),
                ("stream", self.stream, STREAMERS),
                ("job", self.job, ORDERERS),
            )
            for number in range(count)
        ]
        for thread in self.threads:
            thread.start()

    def loop(self, client, noise):
        while not self.ended.is_set():
            if not client(noise):
                return

    def count(self, outcome):
        with self.lock:
            self.outcomes[outcome] += 1

    def lose(self, what):
        since = (
            f", {time.monotonic() - self.told:.2f} s after SIGTERM"
            if self.told
            else ", before SIGTERM"
        )
        with self.lock:
            self.lost.append(what + since)

    def conclude(self, kind, problem):
        """Counts what was accepted; says whether the client goes on."""
        if problem:
            self.lose(f"{kind}: {problem}")
        else:
            self.count(f"{kind} whole")
        return self.told is None

    def send(self, kind, path, noise, headers=()):
        """The answer; None if it was refused, or lost."""
        audio = mp3(noise.choice([5, 10, 20]))
        sent = time.monotonic()
        try:
            if noise.random() < 0.5:
                body, media = form(audio)
            else:
                body, media = audio, "content-type: audio/mpeg"
            reply = ask(self.port, "POST", path, body, [media, *headers], timeout=90)
        except BROKEN as broken:
            # What was sent before the signal was the server's to answer. So was what it began to answer.
            late = self.told is not None and sent >= self.told
            unheard = isinstance(broken, (ConnectionError, http.client.RemoteDisconnected))
            if late and unheard:
                self.count("unheard after SIGTERM")
            else:
                self.lose(f"{kind}: {type(broken).__name__}: {broken}")
            return None
        if reply.status in (429, 503):
            if problem := reply.refusal_problem():
                self.lose(f"{kind}: {problem}")
            if reply.status == 503 and self.told is None:
                self.lose(f"{kind}: 503 {reply.error_type()}")
            self.count(f"{kind} refused")
            return None
        return reply

    def dance(self, noise):
        bvh = noise.random() < 0.5
        path = f"/generate?candidates=1&format={'bvh' if bvh else 'json'}"
        reply = self.send("dance", path, noise)
        if reply is None:
            return False
        problem = dance_problem(reply, bvh) if reply.status == 200 else f"status {reply.status}"
        return self.conclude("dance", problem)

    def stream(self, noise):
        lines = noise.random() < 0.5
        reply = self.send(
            "stream", "/generate/stream?candidates=1", noise, [LINES] if lines else []
        )
        if reply is None:
            return False
        problem = stream_problem(reply, lines) if reply.status == 200 else f"status {reply.status}"
        return self.conclude("stream", problem)

    def job(self, noise):
        reply = self.send("job", "/jobs?candidates=1", noise)
        if reply is None:
            return False
        try:
            problem = self.fetch(reply) if reply.status == 202 else f"status {reply.status}"
        except (*BROKEN, ValueError, KeyError) as broken:
            problem = f"{type(broken).__name__}: {broken}"
        return self.conclude("job", problem)

    def fetch(self, reply):
        """Waits for a job and fetches its dance; what is wrong, or None."""
        where = reply.headers["location"]
        state = json.loads(reply.body)["state"]
        until = time.monotonic() + 60
        while state in ("queued", "running") and time.monotonic() < until:
            time.sleep(0.1)
            reply = ask(self.port, "GET", where)
            if reply.status != 200:
                return f"{where}: {reply.status}"
            state = json.loads(reply.body)["state"]
        if state != "done":
            return f"{where} is {state}: {reply.body[:200]!r}"
        return dance_problem(ask(self.port, "GET", f"{where}/result?format=bvh"), is_bvh=True)

    def finish(self):
        """Waits until every client has ended what it had begun."""
        self.ended.set()
        for thread in self.threads:
            thread.join(120)
        if any(thread.is_alive() for thread in self.threads):
            self.lose("a client still waits for its answer")


def time_to_unready(server, told):
    """Seconds until /ready says 503, and what is wrong with that answer."""
    while time.monotonic() - told < 5:
        try:
            reply = server.get("/ready", timeout=5)
        except BROKEN as broken:
            return time.monotonic() - told, f"/ready: {type(broken).__name__}: {broken}"
        if reply.status == 503:
            return time.monotonic() - told, reply.refusal_problem()
    return time.monotonic() - told, "/ready does not say 503"


def refuses(server):
    """What is wrong with how new work is refused while the old goes on; None if nothing is."""
    body, media = form(mp3(5))
    try:
        reply = ask(server.port, "POST", "/generate", body, [media])
    except BROKEN:
        # All work had ended meanwhile.
        return None
    return (
        None if reply.status == 503 and not reply.refusal_problem() else f"new work: {reply.status}"
    )


def one_round(options, number, seed, noise, verdict):
    """Starts a server, loads it, stops it. Gives what was seen."""
    with Server(options) as server:
        deadline = server.limits()["shutdown_timeout_s"]
        load = Load(server, f"{seed} {number}")
        time.sleep(noise.uniform(0.3, 2.5))
        gauges = server.metrics()
        running = int(gauges.sum("bailando_requests_running"))
        jobs = int(
            gauges.sum("bailando_jobs", state="running")
            + gauges.sum("bailando_jobs", state="queued")
        )
        load.told = told = time.monotonic()
        server.terminate()
        unready, problem = time_to_unready(server, told)
        problem = problem or refuses(server)
        code = server.wait(deadline + 10)
        took = time.monotonic() - told
        load.finish()
        verdict.note(
            f"round {number}: {running} running, {jobs} jobs; /ready 503 after {1000 * unready:.0f} ms; "
            f"exit code {code} after {took:.1f} s; {dict(sorted(load.outcomes.items()))}"
        )
        lost = [f"round {number}: {what}" for what in load.lost]
        problems = [f"round {number}: {problem}"] if problem else []
        if code != 0:
            problems.append(f"round {number}: exit code {code}: {server.log()[-500:]}")
        if running + jobs == 0:
            problems.append(f"round {number}: nothing was under way")
        return unready, took / deadline, lost, problems, load.outcomes


def main():
    def extend(parser):
        parser.add_argument("--rounds", type=int, help="how many times [default: 20]")
        parser.add_argument("--seed", type=int, default=1)

    options = arguments(__doc__, extend)
    verdict = Verdict(7, options.quick)
    rounds = options.rounds or (2 if options.quick else 20)
    noise = random.Random(options.seed)
    seen = [
        one_round(options, number, options.seed, noise, verdict) for number in range(1, rounds + 1)
    ]
    unready, took, lost, problems, outcomes = zip(*seen)
    total = sum(outcomes, Counter())
    verdict.note(f"in all: {dict(sorted(total.items()))}; /ready: {times(unready)}")
    verdict.problems("accepted requests that were lost", [what for each in lost for what in each])
    verdict.problems(
        "other faults: exit codes, refusals, nothing to do",
        [what for each in problems for what in each],
    )
    for kind in ("dance", "stream", "job"):
        verdict.at_least(f"{kind}s that ended whole", total[f"{kind} whole"], rounds)
    verdict.at_most(
        "/ready 503 after SIGTERM, slowest",
        1000 * percentile(unready, 100),
        1000 * READY_WITHIN,
        "ms",
        timed=True,
    )
    verdict.at_most("end by drain deadline, slowest", max(took), 1.0)
    verdict.finish()


if __name__ == "__main__":
    main()
