"""Attacks of one client, each beside an honest one, against a server of its own."""

import contextlib
import http.client
import json
import threading
import time

from guard import GREEDY, HONEST, Honest, key
from harness import MIB, Server, Verdict, arguments
from songs import mp3

MOST_MEMORY = 1024
# A server that takes more is ended, before it takes the machine.
FAR_TOO_MUCH = 4096
MPEG = "content-type: audio/mpeg"


def together(count, work):
    """What `work` gives, so many times at once; what fails is left out."""
    results = []

    def once(number):
        try:
            results.append(work(number))
        except (OSError, http.client.HTTPException) as error:
            results.append(error)

    threads = [threading.Thread(target=once, args=(n,), daemon=True) for n in range(count)]
    for thread in threads:
        thread.start()
    return threads, results


def statuses(results):
    """How often each answer was given, and the longest wait for one."""
    counts, longest = {}, 0.0
    for reply in results:
        name = type(reply).__name__
        if hasattr(reply, "status"):
            name = str(reply.status) + (f" {reply.error_type()}" if reply.status >= 400 else "")
            longest = max(longest, reply.seconds)
        counts[name] = counts.get(name, 0) + 1
    return f"{counts}, longest {longest:.1f} s"


def settled(threads, seconds):
    until = time.monotonic() + seconds
    for thread in threads:
        thread.join(max(0.0, until - time.monotonic()))


def order(server, query="", body=None, owner=GREEDY, headers=()):
    headers = [key(owner), "content-type: application/octet-stream", *headers]
    return server.post(f"/jobs?{query}", mp3(1) if body is None else body, headers)


def state(server, name):
    return json.loads(server.get(f"/jobs/{name}", [key(GREEDY)]).body)["state"]


def finished(server, *names):
    """Waits until jobs of the greedy client are done."""
    while any(state(server, name) != "done" for name in names):
        time.sleep(0.2)


def padded(number):
    """Codes of two seconds in a text of a megabyte."""
    return "[[1,2],[3,4]" + " " * 1_040_000 + f",[{number % 500},6]]"


def watch(server):
    """Ends a server that takes far too much memory."""

    def look():
        # A process that has ended has no memory.
        with contextlib.suppress(OSError, TypeError):
            while (peak := server.peak_rss()) < FAR_TOO_MUCH * MIB:
                time.sleep(0.05)
            server.peak = peak
            server.process.kill()

    threading.Thread(target=look, daemon=True).start()


def run(row, description, attacks, prepare=lambda _: ([], {})):
    """All attacks, or those that the command line names; `prepare` gives flags and environment."""
    names = [attack.__name__ for attack in attacks]
    options = arguments(
        description,
        lambda parser: parser.add_argument("attacks", nargs="*", choices=[[], *names], default=[]),
    )
    verdict = Verdict(row, options.quick)
    for attack in attacks:
        name = attack.__name__
        if options.attacks and name not in options.attacks:
            continue
        flags, environment = prepare(attack)
        flags = ["--api-key", f"{GREEDY},{HONEST}", *flags]
        with Server(options, *flags, env=environment) as server:
            server.data, server.peak = environment.get("BAILANDO_DATA_DIR"), 0
            watch(server)
            honest = Honest(server)
            try:
                verdict.note(f"{name}: {attack(server)}")
            except (AssertionError, OSError, http.client.HTTPException) as problem:
                verdict.check(name, repr(problem), "must not be", False)
            while len(honest.dances) < 3 and server.is_alive():
                time.sleep(0.2)
            honest.judge(verdict, name)
            peak = (server.peak_rss() if server.is_alive() else server.peak) / MIB
            verdict.at_most(f"{name}: peak of memory", peak, MOST_MEMORY, "MiB")
            server.stop(verdict)
    verdict.finish()
