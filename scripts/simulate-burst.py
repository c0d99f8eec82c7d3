#!/usr/bin/env python3
"""Simulates a launch day: jobs arrive, workers are added by an autoscaler, jobs wait.

Arrivals are a Poisson process whose rate rises to a peak and falls again; songs have lengths; a
worker has a number of places, which share its cores. The autoscaler is what deploy/helm sets up: KEDA
counts jobs that wait or are worked on, asks for one worker for so many of them, and a worker that is
asked for takes its time to come (a processor that is free, or a machine that is started first).

Prints a table of scenarios. `--check` compares the engine with results that are known without it: a
D/D/c queue job by job, an M/M/c queue with Erlang's C formula. Seeded: the same call prints the same.

Usage: scripts/simulate-burst.py [--seed N] [--check]
"""

import argparse
import heapq
import math
import random
import sys
from collections import deque
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Scenario:
    """A launch day and what it meets. Times are seconds."""

    # Songs: their mean length, and the spread of its logarithm.
    song: float = 200.0
    spread: float = 0.3
    # Processor seconds for a second of music, and for a job beside them (docs/capacity.md).
    work: float = 0.0185
    work_each: float = 0.08
    # A worker: jobs at once, and cores that they share.
    places: int = 4
    cores: float = 2.0
    # Arrivals: jobs a second before, and at the peak, which is reached after `rise`.
    before: float = 0.5
    peak: float = 10.0
    rise: float = 300.0
    plateau: float = 3600.0
    fall: float = 3600.0
    # deploy/helm/values.yaml: worker.autoscaling.
    least: int = 2
    most: int = 60
    jobs_per_worker: float = 4.0
    polling: float = 10.0
    cooldown: float = 300.0
    # From the wish for a worker to its first job.
    delay: float = 30.0
    # Kubernetes' own: how often the autoscaler acts, and how many it adds at once.
    sync: float = 15.0
    adds: int = 4

    def rate(self, time):
        """Jobs a second at a time."""
        if time < self.rise:
            return self.before + (self.peak - self.before) * time / self.rise
        time -= self.rise + self.plateau
        if time < 0:
            return self.peak
        return max(self.before, self.peak - (self.peak - self.before) * time / self.fall)

    @property
    def length(self):
        return self.rise + self.plateau + self.fall


class Queue:
    """Jobs, first come, first served; workers that come and go; an autoscaler that is asked."""

    def __init__(self, places, rate, workers):
        # Of a worker: jobs at once, and what one place does in a second of what it does alone.
        self.places, self.rate = places, rate
        self.free = workers * places
        self.workers, self.leaving = workers, 0
        self.waiting, self.events, self.number = deque(), [], 0
        self.running, self.now = 0, 0.0
        self.waits, self.ends = [], []
        self.core_seconds, self.changed = 0.0, 0.0
        self.most_waiting, self.most_workers = 0, workers

    def at(self, time, what, *values):
        self.number += 1
        heapq.heappush(self.events, (time, self.number, what, values))

    def arrive(self, work):
        self.waiting.append((self.now, work))
        self.begin()
        self.most_waiting = max(self.most_waiting, len(self.waiting))

    def begin(self):
        while self.waiting and self.free > 0:
            came, work = self.waiting.popleft()
            self.free -= 1
            self.running += 1
            self.waits.append(self.now - came)
            end = self.now + work / self.rate
            self.ends.append(end - came)
            self.at(end, self.end)

    def end(self):
        self.running -= 1
        # A worker that is to go takes no more jobs and ends with its last one.
        if self.leaving > 0:
            self.leaving -= 1
        else:
            self.free += 1
        self.begin()

    def resize(self, change):
        """Adds workers or lets some go: free places at once, others when their jobs are done."""
        self.core_seconds += self.workers * (self.now - self.changed)
        self.workers, self.changed = self.workers + change, self.now
        self.most_workers = max(self.most_workers, self.workers)
        places = change * self.places
        if places > 0:
            stay = min(self.leaving, places)
            self.leaving -= stay
            self.free += places - stay
            self.begin()
        else:
            gone = min(self.free, -places)
            self.free -= gone
            self.leaving += -places - gone

    def run(self, until=math.inf):
        while self.events and self.events[0][0] <= until:
            self.now, _, what, values = heapq.heappop(self.events)
            what(*values)
        self.core_seconds += self.workers * (self.now - self.changed)
        self.changed = self.now


class Autoscaler:
    """KEDA and the horizontal autoscaler behind it, as the chart configures them."""

    def __init__(self, queue, scenario):
        self.queue, self.scenario = queue, scenario
        self.asked, self.wanted = queue.workers, queue.workers
        self.wishes = deque()
        queue.at(0.0, self.poll)
        queue.at(0.0, self.act)

    def poll(self):
        queue, scenario = self.queue, self.scenario
        jobs = len(queue.waiting) + queue.running
        wish = math.ceil(jobs / scenario.jobs_per_worker)
        self.wanted = min(scenario.most, max(scenario.least, wish))
        if jobs or queue.now < scenario.length:
            queue.at(queue.now + scenario.polling, self.poll)

    def act(self):
        queue, scenario = self.queue, self.scenario
        # The most of what was wished for lately: nothing goes before that time is over.
        self.wishes.append((queue.now, self.wanted))
        while self.wishes[0][0] < queue.now - scenario.cooldown:
            self.wishes.popleft()
        if self.wanted > self.asked:
            # Doubled, or so many more, whichever is more, in every step.
            step = min(self.wanted - self.asked, max(self.asked, scenario.adds))
            self.asked += step
            queue.at(queue.now + scenario.delay, queue.resize, step)
        else:
            target = max(wish for _, wish in self.wishes)
            # Half of them a minute.
            step = min(self.asked - target, math.ceil(self.asked / 2 * scenario.sync / 60))
            step = min(step, queue.workers - scenario.least)
            if step > 0:
                self.asked -= step
                queue.resize(-step)
        if queue.waiting or queue.running or queue.now < scenario.length:
            queue.at(queue.now + scenario.sync, self.act)


def simulate(scenario, seed):
    """What has become of the jobs of a launch day."""
    noise = random.Random(seed)
    # When all places are busy, which is when it matters, each has its share of the cores.
    queue = Queue(scenario.places, scenario.cores / scenario.places, scenario.least)
    Autoscaler(queue, scenario)
    time, busiest = 0.0, max(scenario.peak, scenario.before)
    while (time := time + noise.expovariate(busiest)) < scenario.length:
        # Thinned from a process of the highest rate.
        if noise.random() * busiest < scenario.rate(time):
            mu = math.log(scenario.song) - scenario.spread**2 / 2
            song = noise.lognormvariate(mu, scenario.spread)
            queue.at(time, queue.arrive, scenario.work_each + scenario.work * song)
    queue.run()
    return queue


def percentile(values, percent):
    ordered = sorted(values)
    return ordered[max(0, math.ceil(percent / 100 * len(ordered)) - 1)]


def clock(seconds):
    """A time as a reader likes it."""
    return f"{seconds:.0f} s" if seconds < 600 else f"{seconds / 60:.0f} min"


COLUMNS = ["", "jobs", "waits p50", "p95", "p99", "longest", "done within a minute",
           "most waiting", "most workers", "core-hours"]  # fmt: skip


def row(name, scenario, seed):
    queue = simulate(scenario, seed)
    waits = [clock(percentile(queue.waits, percent)) for percent in (50, 95, 99, 100)]
    soon = sum(end <= 60 for end in queue.ends) / len(queue.ends)
    hours = queue.core_seconds * scenario.cores / 3600
    return [name, f"{len(queue.ends):,}", *waits, f"{100 * soon:.1f} %",
            f"{queue.most_waiting:,}", str(queue.most_workers), f"{hours:.0f}"]  # fmt: skip


def table(scenarios, seed):
    rows = [COLUMNS, ["---"] * len(COLUMNS)]
    rows += [row(name, scenario, seed) for name, scenario in scenarios]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows)


# Known results.


def check_deterministic():
    """D/D/c: n jobs at once, each of so many seconds, wait for those before them: job k for
    floor(k / c) of them; exactly."""
    workers, seconds, jobs = 3, 2.0, 20
    queue = Queue(1, 1.0, workers)
    for _ in range(jobs):
        queue.at(0.0, queue.arrive, seconds)
    queue.run()
    known = [job // workers * seconds for job in range(jobs)]
    assert queue.waits == known, (queue.waits, known)
    # Regular arrivals a second apart, one place of 2 s: job k comes at k and begins at 2 k.
    queue = Queue(1, 1.0, 1)
    for job in range(jobs):
        queue.at(float(job), queue.arrive, seconds)
    queue.run()
    assert queue.waits == [float(job) for job in range(jobs)], queue.waits
    print(f"D/D/{workers} and D/D/1: all {2 * jobs} waits as computed by hand")


def check_growth():
    """A worker that comes takes what waits: 4 jobs of 10 s, one place, another place after 5 s."""
    queue = Queue(1, 1.0, 1)
    for _ in range(4):
        queue.at(0.0, queue.arrive, 10.0)
    queue.at(5.0, queue.resize, 1)
    queue.run()
    assert queue.waits == [0.0, 5.0, 10.0, 15.0], queue.waits
    assert queue.core_seconds == 5 + 2 * 20, queue.core_seconds
    # One that goes ends its job first: 4 jobs of 10 s, two places, one of them until 5 s.
    queue = Queue(1, 1.0, 2)
    for _ in range(4):
        queue.at(0.0, queue.arrive, 10.0)
    queue.at(5.0, queue.resize, -1)
    queue.run()
    assert queue.waits == [0.0, 0.0, 10.0, 20.0], queue.waits
    print("a worker that comes, and one that goes: as computed by hand")


def check_erlang(seed):
    """M/M/c: the mean wait is C(c, a) / (c mu - lambda), with Erlang's C formula."""
    arrivals, service, servers, jobs, runs = 8.0, 1.0, 10, 20_000, 10
    load = arrivals / service
    terms = [load**n / math.factorial(n) for n in range(servers)]
    last = load**servers / math.factorial(servers) * servers / (servers - load)
    known = last / (sum(terms) + last) / (servers * service - arrivals)
    noise, means = random.Random(seed), []
    for _ in range(runs):
        queue, time = Queue(1, 1.0, servers), 0.0
        for _ in range(jobs):
            time += noise.expovariate(arrivals)
            queue.at(time, queue.arrive, noise.expovariate(service))
        queue.run()
        # Without the time in which it fills.
        means.append(sum(queue.waits[jobs // 10 :]) / (jobs - jobs // 10))
    mean = sum(means) / runs
    error = math.sqrt(sum((value - mean) ** 2 for value in means) / (runs - 1) / runs)
    assert abs(mean - known) < 4 * error, (mean, known, error)
    print(f"M/M/{servers}: mean wait {mean:.4f} s, Erlang's C says {known:.4f} s, "
          f"standard error {error:.4f}")  # fmt: skip


def scenarios(usual):
    """The rows of docs/capacity.md."""
    machine = replace(usual, delay=180.0)
    return {
        "How long a worker takes to come": [
            ("in 10 s (room on the machines)", replace(usual, delay=10.0)),
            ("in 30 s (room, image pulled)", usual),
            ("in 180 s (a machine is started)", machine),
            ("in 180 s, 20 workers kept ready", replace(machine, least=20)),
            ("never (2 workers, no autoscaling)", replace(usual, most=usual.least)),
        ],
        "How steep the day begins, workers in 180 s": [
            ("peak after an hour", replace(machine, rise=3600.0)),
            ("after five minutes", machine),
            ("at once", replace(machine, rise=1.0)),
        ],
        "How many workers there may be": [
            (f"{most}", replace(usual, most=most)) for most in (10, 20, 30, 60)
        ],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="[default: 1]")
    parser.add_argument("--check", action="store_true", help="compare with known results")
    options = parser.parse_args()
    if options.check:
        check_deterministic()
        check_growth()
        check_erlang(options.seed)
        return
    for title, rows in scenarios(Scenario()).items():
        print(f"{title}:\n\n{table(rows, options.seed)}\n")


if __name__ == "__main__":
    sys.exit(main())
