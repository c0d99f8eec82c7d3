#!/usr/bin/env python3
"""Row 2: decode bombs, small files that claim or hold far too much.

Each is answered with a 4xx within 500 ms, and the server's memory rises by 64 MiB at most; an MP3
behind a tag of a wrong size is danced to, as docs/audio.md says. One dance is made before, so that
what every dance leaves behind is no part of the rise.
"""

import struct

from client import dance_problem
from harness import MIB, Server, Verdict, arguments, percentile
from songs import fixture, long_wav, mp3, silent_flac, wav

HOURS = 36_000 * 48_000
SLOWEST = 0.5
READ_ALL_THE_SAME = "mp3 behind a tag of 256 MiB"
MOST_MEMORY = 64


def endless_table():
    """An M4A whose table says that millions of samples are 2 kB each, more than it holds."""
    file = bytearray(fixture("demo.m4a"))
    at = file.index(b"stsz") + 8
    file[at : at + 8] = struct.pack(">II", 2_000, 4_000_000)
    return bytes(file)


def with_tag(size):
    """An MP3 behind a tag that says it is larger than the file."""
    coded = bytes(size >> shift & 0x7F for shift in (21, 14, 7, 0))
    return b"ID3\x04\0\0" + coded + mp3(2)


def bombs():
    second = long_wav(1)[44:]
    kib = bytes(1024 - 44)
    return {
        "flac, 10 h of silence": silent_flac(48_000, 1, HOURS),
        "flac, 10 h of silence in 8 channels": silent_flac(48_000, 8, HOURS),
        "flac, 10 h in 8 channels that says it is 1 s": silent_flac(
            48_000, 8, HOURS, declared=48_000
        ),
        "flac, 10 h in 8 channels that does not say how long": silent_flac(
            48_000, 8, HOURS, declared=0
        ),
        "flac, 1.4 s that says it is the longest there is": silent_flac(
            48_000, 8, 65_535, declared=(1 << 36) - 1
        ),
        "flac of sample rate 0": silent_flac(0, 1, 480_000),
        "wav, 1 KiB that says it has 1e9 frames": wav(1, 44_100, kib, declared=2_000_000_000),
        "wav, 1 KiB that says it has the most bytes": wav(2, 44_100, kib, declared=0xFFFF_FFFF),
        "wav of sample rate 0": wav(1, 0, second),
        "wav of sample rate 1": wav(1, 1, second),
        "wav of sample rate 4294967295": wav(1, 0xFFFF_FFFF, second),
        "wav of 0 channels": wav(0, 44_100, second),
        "wav of 255 channels": wav(255, 44_100, second),
        "wav of 65535 channels": wav(65_535, 44_100, second),
        "wav of 64 bits that says it has 1e9 frames": wav(
            255, 192_000, kib, bits=64, declared=0xFFFF_FFF0
        ),
        "m4a whose table has no end": endless_table(),
        READ_ALL_THE_SAME: with_tag(0x0FFF_FFFF),
    }


def main():
    options = arguments(__doc__)
    verdict = Verdict(2, options.quick)
    rounds = 1 if options.quick else 5
    problems, seconds = [], []
    with Server(options) as server:
        assert server.post("/generate?candidates=1", mp3(5)).status == 200
        before = server.rss()
        server.forget_peak()
        for name, bomb in bombs().items():
            replies = [server.post("/generate", bomb) for _ in range(rounds)]
            slowest = max(reply.seconds for reply in replies)
            seconds += [reply.seconds for reply in replies]
            reply = replies[0]
            rise = (server.peak_rss() - before) / MIB
            verdict.note(
                f"{name}, {len(bomb) / 1024:.0f} KiB: {reply.status} {reply.error_type()}, "
                f"at most {1000 * slowest:.0f} ms, memory so far +{rise:.1f} MiB"
            )
            for reply in replies:
                refused = 400 <= reply.status < 500 and not reply.refusal_problem()
                danced = reply.status == 200 and not dance_problem(reply)
                if not (danced if name == READ_ALL_THE_SAME else refused):
                    problems.append(f"{name}: {reply.status} {reply.body[:100]!r}")
        verdict.problems("answers other than a 4xx in our shape", problems)
        verdict.at_most("slowest answer", 1000 * max(seconds), 1000 * SLOWEST, "ms", timed=True)
        verdict.note(f"half of them within {1000 * percentile(seconds, 50):.0f} ms")
        verdict.at_most("rise of memory", (server.peak_rss() - before) / MIB, MOST_MEMORY, "MiB")
        server.stop(verdict)
    verdict.finish()


if __name__ == "__main__":
    main()
