#!/usr/bin/env python3
"""Row 20: the clock of the machine jumps.

A server with a data directory runs under a clock that is set forward and back (clock.c), by seconds,
hours and a day, while jobs wait and are worked on, dances are made and streams are read.
Every job that was answered 202 must be done within two minutes of each jump with a whole result, and
begun no more often than --job-starts says; dances and streams must not notice. The monotonic clock
goes on, as it does when a machine's clock is set.
"""

import json
import struct
import subprocess
import threading
import time
from pathlib import Path

from client import ask, dance_problem, stream_problem
from harness import Server, Verdict, arguments, scratch
from songs import mp3

HOUR, DAY = 3600, 86_400
# Seconds that the clock is off by after each jump: before and beyond a lease, an hour, a day.
OFFSETS = [10, -10, 40, -40, 0, HOUR, -HOUR, 0, 25 * HOUR, 0, -25 * HOUR, 0]
STARTS, JOBS, DONE_WITHIN, DANCE_WITHIN = 10, 5, 120.0, 3.0
STREAM = "/generate/stream"
MP3 = ["content-type: audio/mpeg"]


class Clock:
    """The clock of a server, which the test sets."""

    def __init__(self):
        self.file, self.library = scratch() / "clock", scratch() / "clock.so"
        self.file.write_bytes(bytes(8))
        source = Path(__file__).with_name("clock.c")
        command = ["cc", "-Wall", "-Wextra", "-O1", "-shared", "-fPIC", "-o", self.library, source]
        subprocess.run(command, check=True)

    def set(self, offset):
        with self.file.open("r+b") as file:
            file.write(struct.pack("q", offset))

    def environment(self):
        return {
            "LD_PRELOAD": str(self.library),
            "CLOCK_OFFSET": str(self.file),
            "BAILANDO_DATA_DIR": str(scratch() / "data"),
        }


class Stream(threading.Thread):
    """A streamed dance that is read while the clock jumps."""

    def __init__(self, port):
        super().__init__(daemon=True)
        self.port, self.problem = port, "it does not end"
        self.start()

    def run(self):
        self.problem = stream_problem(ask(self.port, "POST", STREAM, mp3(30), MP3, 60))


def order(server, problems):
    reply = ask(server.port, "POST", "/jobs?candidates=4", mp3(30), MP3, 30)
    if reply.status == 202:
        return json.loads(reply.body)["id"]
    problems.append(f"an order was answered {reply.status}: {reply.body[:200]}")
    return None


def state(server, job):
    return json.loads(server.get(f"/jobs/{job}").body)


def wait_until(server, jobs, states, seconds):
    """Waits until all of these jobs are in one of these states; which are not."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        rest = [job for job in jobs if state(server, job).get("state") not in states]
        if not rest:
            return []
        time.sleep(0.1)
    return rest


def jump(server, clock, offset, found):
    """Orders jobs, sets the clock while one is worked on, and waits until all are done."""
    jobs = [order(server, found["orders"]) for _ in range(JOBS)]
    jobs = [job for job in jobs if job]
    wait_until(server, jobs[:1], ("running", "done"), 10)
    stream = Stream(server.port)
    time.sleep(0.2)
    clock.set(offset)
    jobs += filter(None, [order(server, found["orders"])])
    reply = ask(server.port, "POST", "/generate?candidates=1", mp3(4), MP3, 30)
    found["dances"].append(reply.seconds)
    if reply.status != 200 or dance_problem(reply):
        found["refused"].append(f"{offset:+d} s: a dance was answered {reply.status}")
    for job in wait_until(server, jobs, ("done", "failed"), DONE_WITHIN):
        found["lost"].append(f"{offset:+d} s: {state(server, job)}")
    for job in jobs:
        now = state(server, job)
        if now.get("state") != "done":
            found["lost"].append(f"{offset:+d} s: {now}")
        elif problem := dance_problem(server.get(f"/jobs/{job}/result")):
            found["torn"].append(f"{offset:+d} s: {problem}")
        found["starts"].append(now.get("starts", 0))
    stream.join(60)
    if stream.problem:
        found["streams"].append(f"{offset:+d} s: {stream.problem}")


def main():
    options = arguments(__doc__)
    verdict = Verdict(20, options.quick)
    clock = Clock()
    names = ("orders", "dances", "refused", "lost", "torn", "starts", "streams")
    found = {name: [] for name in names}
    flags = ["--job-starts", STARTS, "--client-share", 1]
    with Server(options, *flags, env=clock.environment()) as server:
        for offset in OFFSETS[:4] if options.quick else OFFSETS:
            started = time.monotonic()
            jump(server, clock, offset, found)
            verdict.note(f"clock set to {offset:+d} s: {time.monotonic() - started:.1f} s")
        verdict.note(f"{len(found['starts'])} jobs, begun {sum(found['starts'])} times")
        verdict.problems("orders that were refused", found["orders"])
        verdict.problems("accepted jobs that are lost", found["lost"])
        verdict.problems("results that are torn", found["torn"])
        verdict.at_most("times that a job was begun", max(found["starts"], default=0), STARTS)
        verdict.problems("streams that broke off", found["streams"])
        verdict.problems("dances that were refused", found["refused"])
        verdict.at_most("slowest dance of 4 s", max(found["dances"]), DANCE_WITHIN, "s", timed=True)
        server.stop(verdict)
    verdict.finish()


if __name__ == "__main__":
    main()
