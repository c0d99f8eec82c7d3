#!/usr/bin/env python3
"""Row 5: 64 of the largest legal uploads at the same time.

Each is a WAV file of 100 MB, and each asks for JSON, the largest answer. The server must live, take
at most its idle memory plus, for each place to work in, the documented budget of a request, and
answer what it has no room for with 429 and Retry-After.

The budget is `memory_per_request_bytes` of `GET /info`, or --budget-mib.
"""

import random
import threading
import time
from collections import Counter

from client import connect, dance_problem, head, read_reply
from harness import MIB, Server, Verdict, arguments, times
from songs import mp3, wav

CLIENTS = 64
RATE, CHANNELS = 48_000, 2
HEAD = 44


def largest_file(limits):
    """A WAV file as large as may be: noise, and a click twice a second."""
    block = 2 * CHANNELS
    frames = min(
        (limits["payload_limit_lossless_bytes"] - HEAD) // block,
        int(limits["max_audio_seconds"] * RATE),
    )
    second = bytearray(random.Random(5).randbytes(block * RATE))
    # Quiet noise: the upper byte of each sample tells no more than its sign.
    second[1::2] = bytes(0xFF if low & 0x80 else 0 for low in second[::2])
    for beat in (0, RATE // 2):
        for i in range(200):
            at = block * (beat + i)
            second[at : at + block] = (b"\xff\x5f" if i // 20 % 2 == 0 else b"\0\xa0") * CHANNELS
    data = bytes(second) * (frames // RATE) + bytes(second[: block * (frames % RATE)])
    return wav(CHANNELS, RATE, data)


class Upload(threading.Thread):
    """One client: sends the file, keeps the answer's status and what is wrong with it."""

    def __init__(self, port, file, together):
        super().__init__(daemon=True)
        self.port, self.file, self.together = port, file, together
        self.status, self.problem, self.seconds = None, None, 0.0

    def run(self):
        self.together.wait()
        started = time.monotonic()
        try:
            with connect(self.port, timeout=300) as connection:
                try:
                    connection.sendall(
                        head(
                            "POST",
                            "/generate?candidates=1&format=json",
                            len(self.file),
                            ["content-type: audio/wav"],
                        )
                    )
                    connection.sendall(self.file)
                except (BrokenPipeError, ConnectionResetError):
                    # Refused and hung up: the answer is there, unless it was lost on the way.
                    pass
                reply = read_reply(connection, "POST", started)
            self.status, self.seconds = reply.status, reply.seconds
            if reply.status == 200:
                self.problem = dance_problem(reply)
            else:
                self.problem = reply.refusal_problem()
        except Exception as broken:
            self.problem = f"{type(broken).__name__}: {broken}"


def main():
    def extend(parser):
        parser.add_argument(
            "--budget-mib", type=float, help="memory of one request, if /info does not tell"
        )

    options = arguments(__doc__, extend)
    verdict = Verdict(5, options.quick)
    clients, flags = CLIENTS, []
    if options.quick:
        clients = 12
        flags = ["--payload-limit-lossless", "10MB", "--upload-memory", "40MB"]
    with Server(options, *flags) as server:
        limits = server.limits()
        permits = limits["max_concurrent_requests"]
        assert server.post("/generate?candidates=1", mp3(5)).status == 200
        time.sleep(1)
        idle = server.rss()
        server.forget_peak()
        file = largest_file(limits)
        together = threading.Barrier(clients)
        uploads = [Upload(server.port, file, together) for _ in range(clients)]
        for upload in uploads:
            upload.start()
        for upload in uploads:
            upload.join()
        statuses = Counter(upload.status for upload in uploads)
        danced = [upload.seconds for upload in uploads if upload.status == 200]
        seconds = (len(file) - HEAD) / (2 * CHANNELS * RATE)
        verdict.note(
            f"{clients} uploads of {len(file) / 1e6:.1f} MB, {seconds:.0f} s; answers by status: {dict(statuses)}"
        )
        if danced:
            verdict.note(f"dances: {times(danced)}")
        verdict.equal("answers other than 200 and 429", clients - statuses[200] - statuses[429], 0)
        verdict.problems(
            "answers that are neither whole dances nor whole refusals",
            [upload.problem for upload in uploads if upload.problem],
        )
        verdict.at_least("dances among them", statuses[200], 1)
        verdict.at_least("surplus answered 429", statuses[429], 1)
        if server.is_alive():
            judge_memory(verdict, server, idle, permits, limits, options.budget_mib)
        server.stop(verdict)
    verdict.finish()


def judge_memory(verdict, server, idle, permits, limits, given):
    peak = server.peak_rss()
    rise = (peak - idle) / MIB
    budget = given or limits.get("memory_per_request_bytes", 0) / MIB
    verdict.note(
        f"memory: idle {idle / MIB:.0f} MiB, peak {peak / MIB:.0f} MiB, "
        f"+{rise:.0f} MiB, for each of {permits} places {rise / permits:.0f} MiB"
    )
    if budget:
        verdict.at_most("peak of memory", peak / MIB, idle / MIB + permits * budget, "MiB")
    else:
        verdict.check(
            "budget of one request",
            "unknown",
            "memory_per_request_bytes in /info, or --budget-mib",
            False,
        )
    time.sleep(2)
    verdict.note(f"memory 2 s later: {server.rss() / MIB:.0f} MiB")


if __name__ == "__main__":
    main()
