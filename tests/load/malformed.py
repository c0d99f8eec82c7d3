#!/usr/bin/env python3
"""Row 1: 1,000 malformed files over HTTP.

Mutants of the five formats (bits and bytes changed, parts inserted, taken out, repeated, exchanged,
cut off), and what is no audio at all: nothing, one byte, text, a zip, a PNG. The server must live,
answer none with 5xx, each within 5 s, and each with 200 or a documented 4xx in the shape of our
errors. The same seed makes the same files; one that breaks something is kept in target/load/.
"""

import concurrent.futures
import io
import random
import struct
import time
import zipfile
import zlib
from collections import Counter

from client import dance_problem, form
from harness import Server, Verdict, arguments, keep, times
from songs import MEDIA, fixture, mp3

SLOWEST = 5.0
# As many as are worked on at the same time, so that waiting in line is no part of the times.
CLIENTS = 4


def flip_bits(noise, data, _others):
    data = bytearray(data)
    for _ in range(noise.choice([1, 4, 16, 64, 1000])):
        data[noise.randrange(len(data))] ^= 1 << noise.randrange(8)
    return bytes(data)


def change_head(noise, data, _others):
    """Containers keep what matters most at the start."""
    data = bytearray(data)
    for _ in range(noise.choice([1, 2, 8, 32])):
        data[noise.randrange(min(512, len(data)))] = noise.choice(
            [0, 1, 0x7F, 0x80, 0xFF, noise.randrange(256)]
        )
    return bytes(data)


def change_number(noise, data, _others):
    """Writes a number that is an extreme of some width, anywhere or near the start."""
    at = noise.randrange(min(len(data) - 8, noise.choice([64, 1024, len(data)])))
    number = noise.choice(
        [
            b"\0\0\0\0",
            b"\xff\xff\xff\xff",
            b"\x7f\xff\xff\xff",
            b"\xff\xff\xff\x7f",
            b"\x80\0\0\0",
            b"\0\0\0\x80",
            b"\xff" * 8,
        ]
    )
    return data[:at] + number + data[at + len(number) :]


def insert(noise, data, _others):
    at = noise.randrange(noise.choice([256, len(data)]))
    return data[:at] + noise.randbytes(noise.choice([1, 3, 100, 5000])) + data[at:]


def take_out(noise, data, _others):
    at = noise.randrange(noise.choice([256, len(data)]))
    return data[:at] + data[at + noise.choice([1, 3, 100, 5000]) :]


def repeat(noise, data, _others):
    at, length = noise.randrange(len(data)), noise.choice([4, 100, 5000])
    return data[:at] + data[at : at + length] * noise.choice([2, 20]) + data[at + length :]


def exchange(noise, data, others):
    """The start of one file and the rest of another."""
    other, at = noise.choice(others), noise.choice([16, 512, 20_000])
    return data[:at] + other[at:]


def cut_off(noise, data, _others):
    return data[
        : noise.choice(
            [noise.randrange(1, 64), noise.randrange(1, 4096), noise.randrange(1, len(data))]
        )
    ]


MUTATIONS = [flip_bits, change_head, change_number, insert, take_out, repeat, exchange, cut_off]


def png():
    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    pixels = zlib.compress(b"".join(b"\0" + bytes(3 * 16) for _ in range(16)))
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", 16, 16, 8, 2, 0, 0, 0))
        + chunk(b"IDAT", pixels)
        + chunk(b"IEND", b"")
    )


def zipped():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("song.mp3", mp3(2))
    return file.getvalue()


def no_audio(noise):
    return {
        "nothing": b"",
        "one byte": b"\0",
        "a letter": b"R",
        "text": b"la la la, what a song\n" * 200,
        "json": b'{"file": "song.mp3"}',
        "zip": zipped(),
        "png": png(),
        "zeros": bytes(100_000),
        "noise": noise.randbytes(100_000),
        "noise behind an ID3 tag": b"ID3\x04\0\0\x7f\x7f\x7f\x7f" + noise.randbytes(5000),
    }


def files(count, seed):
    """Name, extension and content of every file."""
    noise = random.Random(seed)
    originals = {
        ending: fixture("demo_44k1_8s.wav" if ending == "wav" else f"demo.{ending}")
        for ending in MEDIA
    }
    # Whole songs take half a second each to dance to; mutants of shorter ones find as much.
    originals["mp3"], originals["wav"] = mp3(8), originals["wav"][: 44 + 2 * 44_100 * 4]
    result = [(name, "mp3", data) for name, data in no_audio(noise).items()]
    for ending, data in originals.items():
        result += [
            (f"first {length} bytes of {ending}", ending, data[:length])
            for length in (4, 12, 44, 200)
        ]
    while len(result) < count:
        ending = noise.choice(list(originals))
        mutation = noise.choice(MUTATIONS)
        data = mutation(noise, originals[ending], list(originals.values()))
        result.append((f"{ending}, {mutation.__name__}", ending, data))
    return result[:count]


def send(server, number, name, ending, data):
    """The answer, or what broke."""
    path = "/generate?format=bvh&candidates=1"
    # What is cut off is heard to its end; of the others every second one only for a while.
    if number % 2 and "cut_off" not in name:
        path += "&duration_s=2"
    started = time.monotonic()
    try:
        if number % 3 == 0:
            body, kind = form(data, f"song.{ending}")
        else:
            body, kind = data, f"content-type: {MEDIA[ending]}"
        return server.post(path, body, [kind], timeout=60)
    except Exception as broken:
        return f"{type(broken).__name__}: {broken} after {time.monotonic() - started:.1f} s"


def judge(reply, documented):
    """What is wrong with an answer; None if nothing is."""
    if isinstance(reply, str):
        return reply
    if reply.status == 200:
        return dance_problem(reply, is_bvh=True)
    if reply.status not in documented or not 400 <= reply.status < 500:
        return f"status {reply.status}: {reply.body[:200]!r}"
    return reply.refusal_problem()


def main():
    def extend(parser):
        parser.add_argument("--seed", type=int, default=1, help="other files with another seed")
        parser.add_argument("--count", type=int, help="how many files [default: 1000]")

    options = arguments(__doc__, extend)
    verdict = Verdict(1, options.quick)
    malformed = files(options.count or (80 if options.quick else 1000), options.seed)
    problems, slow, seconds = [], [], []
    statuses, warned = Counter(), 0
    with Server(options) as server:
        documented = server.documented("POST", "/generate")
        with concurrent.futures.ThreadPoolExecutor(CLIENTS) as pool:
            replies = list(
                pool.map(lambda item: send(server, item[0], *item[1]), enumerate(malformed))
            )
        for number, ((name, ending, data), reply) in enumerate(zip(malformed, replies)):
            whole = not isinstance(reply, str)
            statuses[reply.status if whole else "none"] += 1
            if whole:
                seconds.append(reply.seconds)
                warned += "x-warnings" in reply.headers
            if problem := judge(reply, documented):
                kept = keep(f"malformed-{options.seed}-{number}.{ending}", data)
                problems.append(f"{name}: {problem} ({kept})")
            if not whole or reply.seconds > SLOWEST:
                kept = keep(f"malformed-{options.seed}-{number}.{ending}", data)
                slow.append(f"{name}: {reply.seconds if whole else reply} ({kept})")
        panics = {
            labels["place"]: int(count)
            for labels, count in server.metrics().of("bailando_panics_total")
        }
        verdict.note(
            f"{len(malformed)} files, seed {options.seed}; answers by status: {dict(sorted(statuses.items(), key=str))}"
        )
        verdict.note(
            f"{times(seconds)}; {warned} dances with warnings; panics caught: {panics or 'none'}"
        )
        verdict.equal(
            "answers with 5xx",
            sum(count for status, count in statuses.items() if status != "none" and status >= 500),
            0,
        )
        verdict.problems(f"answers slower than {SLOWEST:g} s, or none", slow)
        verdict.problems(
            "answers that are neither whole dances nor documented 4xx in our shape", problems
        )
        server.stop(verdict)
    verdict.finish()


if __name__ == "__main__":
    main()
