#!/usr/bin/env python3
"""Row 17: files of one client who means harm.

Characters, forms, heads, codes and readers, all attacks or those that are named, each against a
server of its own with default limits. Beside each an honest client with another key asks for a
dance of 4 s and for `/health`. Both must be answered: the dance within 3 s, or with an honest 429.
Memory stays within 1 GiB, and the server ends with 0.
"""

import json
import re
import socket
import struct
import time

from beside import MPEG, padded, run, settled, statuses, together
from characters import bvh, glb, humanoid
from client import HOST, connect, form, head
from guard import GREEDY, Http2, key
from songs import long_wav, mp3


BOUNDARY = b"--a-boundary-that-no-song-holds"


def on_rig(server, rig, song=None, query="", timeout=130):
    """A dance of the greedy client on a character."""
    body, kind = form(mp3(4) if song is None else song)
    part = b'content-disposition: form-data; name="rig"; filename="r"\r\n\r\n'
    body = BOUNDARY + b"\r\n" + part + rig + b"\r\n" + body
    return server.post(f"/generate?{query}", body, [key(GREEDY), kind], timeout)


def rig_joints(server):
    """A character of 10,000 joints for a song of 10 minutes: gigabytes of text."""
    rig = bvh(9_900)
    threads, results = together(3, lambda _: on_rig(server, rig, long_wav(590), "fps=60"))
    settled(threads, 50)
    return statuses(results)


def rig_far(server):
    """Joints so far away that each number has 309 digits."""
    rig = bvh(90, offset=(1e308, -1e308, 1e308))
    threads, results = together(3, lambda _: on_rig(server, rig, long_wav(590), "fps=60"))
    settled(threads, 50)
    return statuses(results)


def rig_spine(server):
    """A spine of 9,900 bones with long names that differ at the end."""
    rig = glb(humanoid(spine=["s" * 4000 + f"{k:05}" for k in range(9_900)]))
    threads, results = together(2, lambda _: on_rig(server, rig, mp3(60)))
    settled(threads, 50)
    return f"{len(rig) / 1e6:.0f} MB: {statuses(results)}"


def rig_parse(server):
    """Avatars of 48 MB that name a million bones, all at once."""
    bones = b",".join(b'"%06x":{"node":1}' % k for k in range(2_300_000))
    nodes = json.dumps(humanoid()["nodes"]).encode()
    text = b'{"asset":{},"nodes":%s,"extensions":{"VRMC_vrm":{"humanoid":{"humanBones":{%s}}}}}'
    rig = glb(text % (nodes, bones))
    threads, results = together(6, lambda _: on_rig(server, rig))
    settled(threads, 50)
    return f"{len(rig) / 1e6:.0f} MB: {statuses(results)}"


def rig_lines(server):
    """A BVH file of 49 MB with one line that is no text."""
    rig = b"HIERARCHY\nROOT a" + b"\xff" * 49_000_000 + b"\nMOTION\n"
    threads, results = together(6, lambda _: on_rig(server, rig))
    settled(threads, 50)
    return statuses(results)


def rig_many(server):
    """Small files that take long to understand, 200 at once."""
    rig = bvh(9_900, name=lambda k: "LeftUpLeg" if k % 2 else "RightForeArm", channels=3)
    wide = glb(humanoid(spine=[f"s{k}" for k in range(9_900)]))
    pair = [rig.replace(b"MOTION", b"JOINT q\n{\n"), wide]
    threads, results = together(200, lambda n: on_rig(server, pair[n % 2], query="duration_s=1"))
    settled(threads, 50)
    return f"{[len(rig) for rig in pair]} bytes: {statuses(results)}"


def rig_odd(server):
    """Files that contradict themselves."""
    node = {"name": "a", "translation": [0, 1, 0]}
    accessor = {"componentType": 5126, "count": 2**62, "type": "VEC4", "bufferView": 2**40}
    external = {"buffers": [{"byteLength": 4, "uri": "file:///etc/passwd"}]}
    data = {"buffers": [{"byteLength": 2**60, "uri": "data:application/octet-stream;base64,AAAA"}]}
    huge = b'{"asset":{},"nodes":[' + b"{}," * 1_000_000 + b"{}]}"
    deep = b'{"asset":{},"extras":' + b"[" * 1_000_000 + b"]" * 1_000_000 + b',"nodes":[]}'
    scaled = humanoid()
    scaled["nodes"][0]["scale"] = [0, 0, 0]
    far = humanoid()
    far["nodes"][0]["scale"] = [1e300, 1e300, 1e300]
    nan = json.dumps(humanoid()).replace("0.85", "NaN").encode()
    sparse = humanoid(accessors=[accessor | {"sparse": {"count": 2**62}}] * 1000)
    rigs = {
        "circle": glb({"asset": {}, "nodes": [node | {"children": [1]}, node | {"children": [0]}]}),
        "accessors": glb(humanoid(accessors=[accessor])),
        "sparse": glb(sparse),
        "external": glb(humanoid(**external)),
        "data": glb(humanoid(**data)),
        "1e6 nodes": glb(huge),
        "deep": glb(deep),
        "scale 0": glb(scaled),
        "scale 1e300": glb(far),
        "NaN": glb(nan),
        "no chunk": b"glTF" + struct.pack("<II", 2, 12),
        "empty chunk": b"glTF" + struct.pack("<III", 2, 20, 0) + b"JSON",
        "controls": bvh(3, name=lambda k: f"a\x1b[2J\x00\x7f{k}"),
        "other letters": bvh(3, name=lambda k: f"骨\u202e{k}\U0001f483"),
        "huge": bvh(1).replace(b"OFFSET 0 0.9 0", b"OFFSET 1e308 1e308 1e308"),
        "tiny": bvh(1).replace(b"0.", b"0.000000000000000000000000000000000001"),
        "million": bvh(1_000_000),
        "BVH deep": b"HIERARCHY\nROOT a\n" + b"{\nJOINT b\n" * 1_000_000,
    }
    seen = {}
    for name, rig in rigs.items():
        reply = on_rig(server, rig)
        seen[name] = (reply.status, round(reply.seconds, 2))
        assert reply.status in (200, 413, 422), (name, reply.status, reply.body[:200])
        assert b"root:" not in reply.body
    slowest = max(seen, key=lambda name: seen[name][1])
    return f"{len(seen)} files, slowest {slowest} {seen[slowest]}: {seen}"


def streams(server):
    """300 readers of dances who take a byte at a time."""
    song, held = mp3(8), []
    for number in range(300):
        path = "/generate/stream"
        kind = "application/x-ndjson" if number % 2 else "text/event-stream"
        wanted = [key(GREEDY), MPEG, f"accept: {kind}"]
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        connection.settimeout(20)
        connection.connect((HOST, server.port))
        connection.sendall(head("POST", path, len(song), wanted) + song)
        connection.setblocking(False)
        held.append((connection, bytearray()))
    until = time.monotonic() + 40
    while time.monotonic() < until:
        for connection, got in held:
            try:
                got += connection.recv(1 if len(got) > 40 else 40)
            except OSError:
                pass
        time.sleep(0.5)
    counts = {}
    for _, got in held:
        line = bytes(got[9:12])
        counts[line] = counts.get(line, 0) + 1
    return f"{counts}"


def forms(server):
    """Forms of 300,000 parts, and of one part with 300,000 headers."""
    part = b'--b\r\ncontent-disposition: form-data; name="%s"\r\n%s\r\n1\r\n'
    parts = b"".join(part % (b"a%d" % k, b"") for k in range(300_000)) + b"--b--\r\n"
    known = b"".join(part % (b"seed", b"") for _ in range(300_000)) + b"--b--\r\n"
    headers = part % (b"seed", b"".join(b"x-%d: 1\r\n" % k for k in range(300_000))) + b"--b--\r\n"
    short = part % (b"seed", b"a:\r\n" * 15_000) + b"--b--\r\n"
    wanted = [key(GREEDY), "content-type: multipart/form-data; boundary=b"]
    seen = {}
    for name, body in {"parts": parts, "known": known, "headers": headers, "short": short}.items():
        reply = server.post("/generate", body, wanted)
        seen[name] = (reply.status, round(reply.seconds, 2))
        assert reply.status == 400, (name, reply.status)
    bodies = [parts, known, headers, short]

    def again(number):
        until = time.monotonic() + 12
        while time.monotonic() < until:
            reply = server.post("/generate", bodies[number % 4], wanted)
        return reply

    threads, results = together(16, again)
    settled(threads, 40)
    return f"{seen}; again and again: {statuses(results)}"


def heads(server):
    """Heads of 300,000 headers, and of 300,000 options."""
    seen = {}
    for name, more in {"headers": b"".join(b"a%d:1\r\n" % k for k in range(300_000)),
                       "small": b"".join(b"a%d:1\r\n" % k for k in range(6_000)),
                       "cookie": b"cookie: " + b"a=1;" * 15_000 + b"\r\n"}.items():  # fmt: skip
        started = time.monotonic()
        with connect(server.port) as connection:
            try:
                connection.sendall(b"GET /info HTTP/1.1\r\nhost: x\r\n" + more + b"\r\n")
            except OSError:
                pass
            try:
                seen[name] = connection.recv(12), round(time.monotonic() - started, 2)
            except OSError as error:
                seen[name] = type(error).__name__, round(time.monotonic() - started, 2)
    same, other = "&".join(["seed=1"] * 9_000), "&".join(f"a{k}" for k in range(9_000))
    for query in (same, other, "%" * 60_000):
        reply = server.post(f"/generate?{query}", mp3(1), [key(GREEDY), MPEG])
        seen[query[:8]] = reply.status, round(reply.seconds, 2)
    return f"{seen}"


def codes(server):
    """Codes as large as they may be, and larger, and JSON without end."""
    texts = {
        "pairs": "[" + "[1,2]," * 170_000 + "[1,2]]",
        "deep": "[" * 1_000_000,
        "dance": '{"codes":{"upper":[1],"lower":[1]},"x":[' + "[]," * 340_000 + "[]]}",
        "keys": "{" + ",".join(f'"{k:x}":1' for k in range(90_000)) + "}",
        "negative": "[[-1,2]]",
        "fraction": "[[1e0,2]]",
        "padded": padded(1),
    }
    seen = {}
    for name, text in texts.items():
        body, kind = form(b"", codes=text, duration_s="1")
        # Without the part of the song.
        body = body[: body.rindex(BOUNDARY + b"\r\n")] + BOUNDARY + b"--\r\n"
        for path in ("/generate", "/generate/file", "/generate/stream"):
            reply = server.post(path, body, [key(GREEDY), kind])
            seen[name] = (reply.status, round(reply.seconds, 2))
            assert reply.status in (200, 400), (name, path, reply.status, reply.body[:99])
        threads, _ = together(16, lambda _: server.post("/generate", body, [key(GREEDY), kind]))
        settled(threads, 20)
    return f"{seen}"


def pages(server):
    """The viewer and the documentation: odd paths, codings, conditions, and 960 streams of them."""
    text = server.get("/").body.decode()
    found = re.findall(r'(?:src|href)="\.?/?([^"#:]+)"', text)
    odd = ["/viewer/../index.html", "/viewer/%2e%2e/%2e%2e/etc/passwd", "/viewer//etc/passwd",
           "/docs/..", "/docs/%00", "/viewer/" + "a/" * 9_000,
           "/api-doc/openapi.json?" + "a" * 9_000]  # fmt: skip
    seen = {}
    for path in odd:
        reply = server.get(path)
        seen[reply.status] = seen.get(reply.status, 0) + 1
        assert reply.status in (200, 303, 404) and b"root:" not in reply.body, (path, reply.status)
    largest = max(found, key=lambda name: len(server.get("/" + name).body))
    held = [f"if-none-match: {','.join(['W/x'] * 9000)}", "accept-encoding: br, zstd, gzip"]
    threads, results = together(64, lambda _: server.get("/" + largest, held))
    settled(threads, 20)
    clients = [Http2(server.port, 1) for _ in range(30)]
    for client in clients:
        for _ in range(32):
            client.ask("GET", "/" + largest)
    until = time.monotonic() + 15
    while time.monotonic() < until:
        for client in clients:
            client.hear()
        time.sleep(0.1)
    return f"{seen}; {largest}: {statuses(results)}"


if __name__ == "__main__":
    attacks = [rig_joints, rig_far, rig_spine, rig_parse, rig_lines, rig_many, rig_odd]
    run(17, __doc__, [*attacks, streams, forms, heads, codes, pages])
