#!/usr/bin/env python3
"""Row 16: `kill -9` in every phase, 50 times.

Servers with one data directory are killed and started again while clients order jobs: while a song
is sent, just after an order was answered, while a job is queued, decoded, danced or written, and
while a result is read. Every job that was answered 202 must be done in the end, with a whole result,
and begun no more often than --job-starts says. With --split an API and a worker are killed in turns.
"""

import http.client
import json
import random
import threading
import time
from collections import Counter

from client import ask, connect, dance_problem, head
from harness import Server, Verdict, arguments, scratch, times
from songs import mp3

PHASES = ["upload", "order", "queued", "decode", "features", "inference", "write", "result"]
LEASE = 1
STARTS = 10
BROKEN = (OSError, http.client.HTTPException)
# A phase that is over too soon to be seen is killed blindly.
PATIENCE = 3.0
ALL_DONE = 300


def extend(parser):
    parser.add_argument("--split", action="store_true", help="an API and a worker, in turns")
    parser.add_argument("--rounds", type=int, help="kills [default: 50, or 8 with --quick]")
    parser.add_argument("--database", help="URL of a PostgreSQL database [default: SQLite]")
    parser.add_argument("--model-dir", help="the model [default: the server's]")


class Service:
    """A server, or an API and a worker, that are started again after each kill."""

    def __init__(self, options):
        self.options = options
        self.roles = ["api", "worker"] if options.split else ["all"]
        self.servers = {role: self.start(role) for role in self.roles}
        self.starts = []

    def start(self, role):
        flags = ["--role", role, "--data-dir", scratch() / "data", "--job-lease", LEASE]
        flags += ["--job-starts", STARTS, "--client-share", 1, "--job-timeout", 120]
        if self.options.database:
            flags += ["--database", self.options.database]
        if self.options.model_dir:
            flags += ["--model-dir", self.options.model_dir]
        return Server(self.options, *flags)

    @property
    def api(self):
        return self.servers[self.roles[0]]

    def kill(self, role):
        self.servers[role].kill()
        started = time.monotonic()
        self.servers[role] = self.start(role)
        self.starts.append(time.monotonic() - started)


class Orders:
    """Clients that order one job after another, whatever happens to the server."""

    def __init__(self, service):
        self.service, self.lock = service, threading.Lock()
        self.accepted, self.problems, self.unanswered = [], [], 0
        self.ended = threading.Event()
        self.threads = [
            threading.Thread(target=self.loop, args=(random.Random(number),), daemon=True)
            for number in range(2)
        ]
        for thread in self.threads:
            thread.start()

    def loop(self, noise):
        number = 0
        while not self.ended.is_set():
            number += 1
            with self.lock:
                waiting = len(self.accepted)
            self.order(noise, number)
            # About as many as are done.
            time.sleep(0.5 if waiting < 200 else 2)

    def order(self, noise, number):
        song = mp3(noise.choice([3, 6, 12]))
        key = f"idempotency-key: {noise.random()}-{number}"
        media = "content-type: audio/mpeg"
        for _ in range(3):
            try:
                reply = ask(
                    self.service.api.port, "POST", "/jobs?candidates=1", song, [media, key], 20
                )
            except BROKEN:
                with self.lock:
                    self.unanswered += 1
                time.sleep(0.3)
                continue
            with self.lock:
                if reply.status == 202:
                    self.accepted.append(json.loads(reply.body)["id"])
                elif reply.status not in (429, 503):
                    self.problems.append(f"an order was answered {reply.status}: {reply.body[:200]}")
                elif problem := reply.refusal_problem():
                    self.problems.append(problem)
            return

    def stop(self):
        self.ended.set()
        for thread in self.threads:
            thread.join(60)


def status(service, job):
    """What the server says of a job; None while it does not answer."""
    try:
        reply = service.api.get(f"/jobs/{job}", timeout=10)
    except BROKEN:
        return None
    return json.loads(reply.body) | {"status": reply.status}


def wait_for(phase, service, orders):
    """Waits until a job is in a phase; whether one was."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        listed = json.loads(service.api.get("/jobs?limit=20").body)["jobs"]
        states = {job["state"] for job in listed} | {job.get("stage") for job in listed}
        if phase in states:
            return True
        time.sleep(0.005)
    return False


def until(phase, service, orders, noise):
    """Brings the server into a phase; whether it is in it."""
    if phase == "upload":
        song = mp3(12)
        connection = connect(service.api.port)
        media = ["content-type: audio/mpeg"]
        connection.sendall(head("POST", "/jobs", len(song), media) + song[: len(song) // 2])
        return True
    if phase == "order":
        orders.order(noise, f"last-{noise.random()}")
        return True
    if phase == "result":
        with orders.lock:
            accepted = list(orders.accepted)
        for job in noise.sample(accepted, min(len(accepted), 20)):
            if (status(service, job) or {}).get("state") == "done":
                connection = connect(service.api.port)
                connection.sendall(head("GET", f"/jobs/{job}/result"))
                connection.recv(1000)
                return True
        return False
    return wait_for(phase, service, orders)


def main():
    options = arguments(__doc__, extend)
    verdict = Verdict(16, options.quick)
    noise = random.Random(16)
    rounds = options.rounds or (8 if options.quick else 50)
    service = Service(options)
    orders = Orders(service)
    seen = Counter()
    for number in range(rounds):
        phase = PHASES[number % len(PHASES)]
        time.sleep(noise.uniform(0.2, 1.5))
        if until(phase, service, orders, noise):
            seen[phase] += 1
        service.kill(service.roles[(number // len(PHASES)) % len(service.roles)])
    orders.stop()
    verdict.note(f"{rounds} kills of {' and '.join(service.roles)}, in the phase meant: {dict(seen)}")
    verdict.note(f"ready again after: {times(service.starts)}")

    deadline = time.monotonic() + ALL_DONE
    missing, torn, often, starts = [], [], [], Counter()
    for job in orders.accepted:
        while (now := status(service, job)) is None or now.get("state") in ("queued", "running"):
            if time.monotonic() > deadline:
                break
            time.sleep(0.1)
        if not now or now.get("state") != "done":
            missing.append(f"job {job}: {now}")
            continue
        starts[now["starts"]] += 1
        if now["starts"] > STARTS:
            often.append(f"job {job} was begun {now['starts']} times")
        if problem := dance_problem(service.api.get(f"/jobs/{job}/result"), False):
            torn.append(f"job {job}: {problem}")
    verdict.note(f"{len(orders.accepted)} jobs accepted, {orders.unanswered} orders unanswered")
    verdict.note(f"jobs by how often they were begun: {dict(sorted(starts.items()))}")
    verdict.at_least("jobs accepted", len(orders.accepted), rounds)
    verdict.problems("accepted jobs that are lost", missing)
    verdict.problems("results that are torn", torn)
    verdict.problems("jobs begun more often than --job-starts", often)
    verdict.problems("odd answers to orders", orders.problems)
    for role in service.roles:
        service.servers[role].stop(verdict)
    verdict.finish()


if __name__ == "__main__":
    main()
