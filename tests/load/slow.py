#!/usr/bin/env python3
"""Row 4: slow clients.

500 connections send a request's head and 200 a body at one byte a second, 20 more begin a body and
fall silent. The server's timeouts must drop them all, and normal requests must stay as fast: their
p99 is at most 1.2 times what it is without slow clients. Blocks of requests with and without slow
clients alternate, so that whatever else the machine does falls on both.
"""

import contextlib
import multiprocessing
import os
import selectors
import time
from collections import Counter

from client import connect, dance_problem, hang_up, head
from harness import Server, Verdict, arguments, die_with_parent, percentile, times
from songs import mp3

HEADS, BODIES, SILENT = 500, 200, 20
WORST_RATIO = 1.2
# A timeout that is not exact, and a machine that is busy.
TOLERANCE = 3.0
# An answered client's connection lives on while the rest of its body is read and thrown away.
AFTER_ANSWER = 10.0


class Slow:
    """One slow client: what it sends, when, and what became of it."""

    def __init__(self, kind, port):
        self.kind, self.port = kind, port
        self.answered = self.ended = None
        start = {
            "head": b"POST /generate?format=bvh HTTP/1.1\r\nhost: localhost\r\nx-slow: ",
            "body": head("POST", "/generate?format=bvh", 1_000_000, ["content-type: audio/mpeg"])
            + mp3(2)[:1000],
        }
        self.connection = connect(port)
        self.started = time.monotonic()
        # Of a head only what makes it one: the rest dribbles.
        self.connection.sendall(start["head"][:20] if kind == "head" else start["body"])
        self.rest = start["head"][20:] + b"x" * 1_000_000
        self.sent = 0
        self.answer = b""
        self.connection.setblocking(False)

    def dribble(self):
        if self.ended is None and self.kind != "silent":
            with contextlib.suppress(OSError):
                self.sent += self.connection.send(self.rest[self.sent : self.sent + 1])

    def hear(self):
        """Takes what the server says; notes when it has answered and when it has hung up."""
        try:
            data = self.connection.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        now = time.monotonic() - self.started
        if data:
            self.answer += data
            self.answered = self.answered or now
        else:
            self.ended = now

    def outcome(self):
        status = self.answer[9:12].decode() if self.answer else None
        return self.kind, status, self.answered, self.ended


def crowd(port, kinds, endless, orders, results):
    """A process of slow clients. `endless`: who is dropped is followed by another. It ends when all are
    gone, or when told to."""
    die_with_parent()
    os.nice(5)
    selector = selectors.DefaultSelector()
    clients, outcomes = [], []

    def add(kind):
        with contextlib.suppress(OSError):
            client = Slow(kind, port)
            clients.append(client)
            selector.register(client.connection, selectors.EVENT_READ, client)

    for kind in kinds:
        add(kind)
    results.send(len(clients))
    turn = 0
    while clients and not orders.poll():
        # A twentieth of the clients send a byte every twentieth of a second.
        for client in clients[turn % 20 :: 20]:
            client.dribble()
        turn += 1
        until = time.monotonic() + 0.05
        while (left := until - time.monotonic()) > 0:
            for key, _ in selector.select(left):
                client = key.data
                client.hear()
                if client.ended is not None:
                    selector.unregister(client.connection)
                    client.connection.close()
                    clients.remove(client)
                    outcomes.append(client.outcome())
                    if endless:
                        add(client.kind)
    left = Counter(client.kind for client in clients)
    for client in clients:
        hang_up(client.connection)
    results.send((outcomes, dict(left)))


class Crowd:
    """Slow clients in a process of their own, so that they take nothing of the measuring one's time."""

    def __init__(self, port, kinds, endless):
        # From a fork nothing is imported anew; the test has no threads.
        context = multiprocessing.get_context("fork")
        self.results, results = context.Pipe()
        orders, self.orders = context.Pipe()
        self.process = context.Process(
            target=crowd, args=(port, kinds, endless, orders, results), daemon=True
        )
        self.process.start()
        self.connected = self.results.recv()

    def stop(self):
        with contextlib.suppress(OSError):
            self.orders.send("stop")
        return self.wait(10)

    def wait(self, seconds):
        """What became of the dropped ones, and how many are left; after so long it is told to stop."""
        if not self.results.poll(seconds):
            self.orders.send("stop")
        outcome = self.results.recv()
        self.process.join()
        return outcome


def normal(server, count, problems):
    """Times of so many normal requests, one after another."""
    seconds = []
    for seed in range(count):
        reply = server.post(f"/generate?format=bvh&candidates=1&seed={seed}", mp3(3))
        seconds.append(reply.seconds)
        problem = dance_problem(reply, is_bvh=True)
        if reply.status != 200 or problem:
            problems.append(f"{reply.status}: {problem}")
    return seconds


def judge_drops(verdict, outcomes, left, kinds, limits):
    """Every kind within its own time."""
    deadlines = {
        "head": (limits["header_read_timeout_s"], None),
        # A byte a second is less than the least rate: given up after the first period.
        "body": (limits["body_idle_timeout_s"], "408"),
        "silent": (limits["body_idle_timeout_s"], "408"),
    }
    for kind, (deadline, status) in deadlines.items():
        mine = [outcome for outcome in outcomes if outcome[0] == kind]
        wanted = kinds.count(kind)
        verdict.equal(f"{kind}: dropped", len(mine), wanted)
        if left.get(kind):
            verdict.note(f"  {left[kind]} were left")
        said = Counter(answer for _, answer, _, _ in mine)
        verdict.note(f"  answers: {dict(said)}")
        if status:
            verdict.equal(f"{kind}: answered {status}", said[status], wanted)
        # Who is answered has been dropped with the answer; the connection follows.
        when = [answered or ended for _, _, answered, ended in mine]
        ends = [ended for _, _, _, ended in mine]
        if mine:
            verdict.at_most(f"{kind}: last one dropped", max(when), deadline + TOLERANCE, "s")
            verdict.at_least(f"{kind}: first one dropped", min(when), deadline - TOLERANCE, "s")
            verdict.at_most(
                f"{kind}: last connection closed",
                max(ends),
                deadline + TOLERANCE + AFTER_ANSWER,
                "s",
            )


def main():
    options = arguments(__doc__)
    verdict = Verdict(4, options.quick)
    # All of them come from one address.
    flags, blocks, each = ["--client-share", 1], 5, 60
    kinds = ["head"] * HEADS + ["body"] * BODIES + ["silent"] * SILENT
    if options.quick:
        # Other timeouts, so that it does not last.
        flags += ["--header-read-timeout", 4, "--body-idle-timeout", 5, "--body-timeout", 8]
        blocks, each = 2, 5
    without, among, problems, churned = [], [], [], Counter()
    with Server(options, *flags) as server:
        limits = server.limits()
        normal(server, 5, problems)
        for _ in range(blocks):
            without += normal(server, each, problems)
            slow = Crowd(server.port, kinds, endless=True)
            if slow.connected < len(kinds):
                problems.append(f"{slow.connected} of {len(kinds)} slow clients connected")
            among += normal(server, each, problems)
            outcomes, _ = slow.stop()
            churned.update(kind for kind, *_ in outcomes)
            # What they held is given back before the next block.
            time.sleep(1)
        slow = Crowd(server.port, kinds, endless=False)
        longest = max(
            limits[f"{name}_s"]
            for name in ("header_read_timeout", "body_timeout", "body_idle_timeout")
        )
        outcomes, left = slow.wait(longest + TOLERANCE + AFTER_ANSWER + 5)
        judge_drops(verdict, outcomes, left, kinds, limits)
        time.sleep(1)
        gauges = server.metrics()
        verdict.equal("bodies on their way afterwards", gauges.sum("bailando_uploads"), 0)
        # The one that asks is one.
        verdict.at_most("connections afterwards", gauges.sum("bailando_connections"), 1)
        verdict.problems("normal requests that were not answered with a whole dance", problems)
        verdict.note(f"without slow clients: {times(without)}")
        verdict.note(
            f"among {len(kinds)}, of whom {sum(churned.values())} were dropped and replaced: {times(among)}"
        )
        verdict.at_most(
            "p99 among slow clients by p99 without",
            percentile(among, 99) / percentile(without, 99),
            WORST_RATIO,
            "times",
            timed=True,
        )
        server.stop(verdict)
    verdict.finish()


if __name__ == "__main__":
    main()
