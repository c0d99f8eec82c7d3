#!/usr/bin/env python3
"""Row 18: jobs of one client who means harm.

Orders, their files on the disk, their events, callbacks and results, all attacks or those that are
named, each against a server of its own with default limits. Beside each an honest client with
another key asks for a dance of 4 s and for `/health`. Both must be answered: the dance within 3 s,
or with an honest 429. Memory stays within 1 GiB, and the server ends with 0. `full_disk` and
`read_only` mount a small file system, and are left out where that takes another user than root.
"""

import atexit
import json
import os
import random
import resource
import socket
import sqlite3
import subprocess
import threading
import time
from pathlib import Path

from beside import finished, order, padded, run, settled, statuses, together
from client import HOST, ask, connect, form, hang_up, head
from guard import GREEDY, HONEST, Http2, key, request
from harness import MIB, scratch
from songs import long_wav, mp3


def job_bytes(server):
    """One client fills all bytes for jobs; the other orders then."""
    songs = [order(server, "duration_s=1", long_wav(8 + n)).status for n in range(40)]
    reply = order(server, "duration_s=1", mp3(4), HONEST)
    assert reply.status == 202, (songs, reply.status, reply.error_type())
    return f"{songs.count(202)} of 40 accepted, the other {reply.status}"


def job_list(server):
    """Orders with a megabyte of text each, all listed by 40 readers at once."""
    def one(number):
        body, kind = form(mp3(1), codes=padded(number), duration_s="0.5")
        return ask(server.port, "POST", "/jobs", body, [key(GREEDY), kind], 60)

    accepted = []
    until = time.monotonic() + 25
    while len(accepted) < 300 and time.monotonic() < until:
        threads, results = together(8, lambda n: one(len(accepted) + n))
        settled(threads, 30)
        accepted += [r for r in results if getattr(r, "status", 0) == 202]
    listed = "/jobs?limit=1000"
    threads, results = together(40, lambda _: server.get(listed, [key(GREEDY)], 60))
    settled(threads, 25)
    return f"{len(accepted)} orders; lists: {statuses(results)}"


def events(server):
    """3,200 readers of the events of jobs, over HTTP/2."""
    names = [json.loads(order(server, "priority=-5", long_wav(20)).body)["id"] for _ in range(4)]
    names.append(json.loads(order(server, "candidates=16", long_wav(300)).body)["id"])
    clients = [Http2(server.port, 65_535) for _ in range(100)]
    for number, client in enumerate(clients):
        for _ in range(32):
            client.ask("GET", f"/jobs/{names[number % len(names)]}/events")
        client.hear()
    started, cpu = time.monotonic(), server.cpu_seconds()
    while time.monotonic() < started + 25:
        for client in clients:
            client.hear()
        time.sleep(0.1)
    asked = order(server, "duration_s=1", mp3(4), HONEST)
    assert asked.status == 202, asked.error_type()
    share = (server.cpu_seconds() - cpu) / (time.monotonic() - started)
    alive = sum(client.alive for client in clients)
    return f"{alive} connections alive, {share:.2f} processors, an order {asked.seconds:.2f} s"


def hung_orders(server):
    """Orders of 20 MB that are hung up before they are answered; what is left on the disk."""
    body = long_wav(230)
    for _ in range(40):
        connection = connect(server.port)
        connection.sendall(head("POST", "/jobs?duration_s=0.5", len(body), [key(GREEDY)]) + body)
        time.sleep(random.uniform(0, 0.25))
        hang_up(connection)
    time.sleep(8)
    files = [file for file in Path(server.data).rglob("*") if file.is_file()]
    rows = sqlite3.connect(f"{server.data}/jobs.sqlite").execute("SELECT id FROM jobs").fetchall()
    kept = {row[0] for row in rows}
    left = [file for file in files if file.parent.parent.name == "jobs"
            and file.parent.name not in kept]  # fmt: skip
    size = sum(file.stat().st_size for file in left)
    assert size < 25e6, f"{len(left)} files of no job, {size / 1e6:.0f} MB"
    return f"{len(kept)} jobs, {len(left)} files of none, {size / 1e6:.0f} MB"


def full_disk(server):
    """A disk of 24 MB that one client fills."""
    accepted = [order(server, "duration_s=1", long_wav(20 + n)).status for n in range(24)]
    reply = order(server, "", mp3(4), HONEST)
    worst = set(accepted) - {202, 429, 503}
    assert not worst, worst
    listed = json.loads(server.get("/jobs?limit=100", [key(GREEDY)]).body)["jobs"]
    deleted = [ask(server.port, "DELETE", f"/jobs/{job['id']}", headers=[key(GREEDY)]).status
               for job in listed]  # fmt: skip
    again = order(server, "duration_s=1", mp3(4), HONEST)
    assert again.status == 202, (deleted, again.status, again.error_type())
    seen = f"{accepted.count(202)} accepted, the other {reply.status}"
    return f"{seen}; deleted {set(deleted)}, then {again.status}"


def long_songs(server):
    """Three orders of 95 MB at once, as many as one client may send: they go to the disk."""
    song = long_wav(1_077)
    order(server, "duration_s=1", mp3(5))
    server.forget_peak()
    before = server.rss()
    threads, replies = together(3, lambda _: order(server, "duration_s=1", song))
    settled(threads, 60)
    rise = (server.peak_rss() - before) / MIB
    seen = [getattr(reply, "status", reply) for reply in replies]
    assert seen == [202] * 3, seen
    # One of them may be at work before the last has arrived.
    assert rise < 160, f"memory rose by {rise:.0f} MiB"
    return f"{seen.count(202)} accepted, memory rose by {rise:.0f} MiB"


def read_only(server):
    """A store that lets nothing be written for a while."""
    done = [json.loads(order(server, "duration_s=1", mp3(5)).body)["id"]]
    finished(server, *done)
    result = f"/jobs/{done[0]}/result"
    before = server.get(result, [key(GREEDY)]).body

    def mode(name):
        subprocess.run(["mount", "-o", f"remount,{name}", f"{server.data}/store"], check=True)

    mode("ro")
    try:
        refused = order(server, "", mp3(6))
        assert (refused.status, refused.error_type()) == (503, "job_store"), refused.body
        read = server.get(result, [key(GREEDY)])
        assert read.status == 200 and read.body == before, read.body[:200]
        others = [server.get("/health").status, ask(server.port, "POST", "/generate", mp3(4),
                  ["content-type: audio/mpeg", key(GREEDY)]).status]  # fmt: skip
        assert others == [200, 200], others
    finally:
        mode("rw")
    again = order(server, "duration_s=1", mp3(6))
    assert again.status == 202, again.body
    finished(server, json.loads(again.body)["id"])
    return f"meanwhile {refused.status}, results are read, dances made; then {again.status}"


def damaged(server):
    """Results whose files were damaged on the disk, fetched in every format; broken rows."""
    names = [json.loads(order(server, "format=bvh").body)["id"] for _ in range(6)]
    paths = [f"/jobs/{name}" for name in names]
    finished(server, *names)
    chance, seen = random.Random(1), {}
    for name in names:
        (motion,) = Path(server.data).glob(f"jobs/{name}/*.motion")
        whole = motion.read_bytes()
        for _ in range(25):
            size = len(whole)
            torn = bytearray(whole[: chance.choice([size, size, chance.randrange(1, size)])])
            for _ in range(chance.randrange(1, 9)):
                near = min(len(torn), chance.choice([64, 4096, size]))
                torn[chance.randrange(near)] = chance.randrange(256)
            motion.write_bytes(torn)
            kind = chance.choice(["json", "glb", "fbx", "npz", "vmd", "vrma"])
            status = server.get(f"/jobs/{name}/result?format={kind}", [key(GREEDY)]).status
            seen[status] = seen.get(status, 0) + 1
    rows = sqlite3.connect(f"{server.data}/jobs.sqlite", timeout=10)
    broken = {"result_json": "{", "order_json": "\0", "state": "odd", "starts": -1,
              "finished_at": 2**63 - 1, "result_bytes": "many"}  # fmt: skip
    for column, value in broken.items():
        rows.execute(f"UPDATE jobs SET {column} = ? WHERE id = ?", (value, names.pop()))
    rows.commit()
    after = [server.get(path, [key(GREEDY)]).status for path in [*paths, "/jobs?limit=9"]]
    reply = order(server, "duration_s=1", mp3(4), HONEST)
    assert reply.status == 202, reply.error_type()
    panics = server.metrics().sum("bailando_panics_total")
    assert panics == 0, f"{panics} panics"
    return f"results {seen}, broken rows {after}, the other's order {reply.status}"


def callbacks(server):
    """A host that takes calls and never answers; another client's report."""
    told, taken = [], []

    def listen(answers):
        listener = socket.create_server((HOST, 0), backlog=1000)

        def serve():
            while True:
                connection, _ = listener.accept()
                taken.append(connection)
                if answers:
                    told.append(time.monotonic())
                    connection.recv(65_536)
                    connection.sendall(b"HTTP/1.1 204 No Content\r\ncontent-length: 0\r\n\r\n")

        threading.Thread(target=serve, daemon=True).start()
        return f"http://{HOST}:{listener.getsockname()[1]}/"

    silent, honest = listen(False), listen(True)
    for number in range(30):
        order(server, f"callback_url={silent}{number}", b"no song")
    time.sleep(2)
    started = time.monotonic()
    reply = order(server, f"callback_url={honest}", b"no song", HONEST)
    assert reply.status == 202, reply.error_type()
    while not told and time.monotonic() < started + 40:
        time.sleep(0.1)
    waited = (told or [started + 999])[0] - started
    assert waited < 15, f"told after {waited:.0f} s"
    return f"told after {waited:.1f} s"


def ranges(server):
    """Odd ranges of one result, by 30 readers at once."""
    name = json.loads(order(server, "format=bvh", mp3(30)).body)["id"]
    path = f"/jobs/{name}/result"
    finished(server, name)
    many = ",".join(f"{k}-{k + 9}" for k in range(6_000))
    odd = ["0-", "-1", "0-18446744073709551615", "18446744073709551615-", "99999999999999999999-",
           "-18446744073709551615", many, "5-3", "-", "0-0", "0x10-", " 1 - 2 ", "1-2;3"]
    seen = {}
    for kind in ("bvh", "json"):
        for text in odd:
            wanted = [key(GREEDY), f"range: bytes={text}"]
            reply = server.get(f"{path}?format={kind}", wanted)
            seen[reply.status] = seen.get(reply.status, 0) + 1
            assert reply.status in (200, 206, 416), (text, reply.status)
    threads, results = together(
        30, lambda n: server.get(path, [key(GREEDY), f"range: bytes={','.join(['0-'] * 8000)}"])
    )
    settled(threads, 20)
    return f"{seen}; many ranges: {statuses(results)}"


def guesses(server):
    """Ids of jobs, of others and of none, in all writings."""
    name = json.loads(order(server, "duration_s=1", mp3(4), HONEST).body)["id"]
    odd = [name, name.upper(), name.replace("-", ""), f"{{{name}}}", f"urn:uuid:{name}", "..",
           "..%2f..%2fjobs.sqlite", "%00", "a" * 5000, "%", f"{0:032}"]  # fmt: skip
    seen = []
    for text in odd:
        for method, end in (("GET", ""), ("GET", "/result"), ("GET", "/events"), ("DELETE", "")):
            reply = ask(server.port, method, f"/jobs/{text}{end}", headers=[key(GREEDY)])
            seen.append(reply.status)
            assert reply.status in (400, 404), (text, method, end, reply.status)
    kept = order(server, "duration_s=1", mp3(4), HONEST, ["idempotency-key: k"])
    other = order(server, "duration_s=2", mp3(3), GREEDY, ["idempotency-key: k"])
    names = [json.loads(reply.body)["id"] for reply in (kept, other)]
    assert names[0] != names[1]
    mine = server.get("/jobs", [key(GREEDY)]).body.decode()
    assert name not in mine and names[0] not in mine
    return f"{len(seen)} guesses: {sorted(set(seen))}"


def coded(server):
    """A result of five minutes, compressed anew for 20 readers, again and again."""
    name = json.loads(order(server, "music=false", long_wav(300)).body)["id"]
    finished(server, name)
    until, path = time.monotonic() + 20, f"/jobs/{name}/result"
    written = ["include=rotations", "format=fbx", "format=bvh&bvh_unit=m", "encoding=base64"]

    def again(number):
        kinds = ("br", "zstd", "gzip")
        while time.monotonic() < until:
            wanted = [key(GREEDY), f"accept-encoding: {kinds[number % 3]}"]
            reply = server.get(f"{path}?{written[number % 4]}", wanted, 90)
        return reply

    threads, results = together(20, again)
    settled(threads, 60)
    return statuses(results)


def result_streams(server):
    """6,400 HTTP/2 readers of a stored file who take a byte each."""
    name = json.loads(order(server, "format=json", long_wav(60)).body)["id"]
    finished(server, name)
    clients = [Http2(server.port, 1) for _ in range(200)]
    for client in clients:
        for _ in range(32):
            client.ask("GET", f"/jobs/{name}/result")
        client.hear()
    most, until = 0, time.monotonic() + 20
    while time.monotonic() < until:
        for client in clients:
            client.hear()
        most = max(most, server.descriptors())
        time.sleep(0.1)
    assert most < 2200, f"{most} descriptors"
    return f"{most} descriptors"


def few_files(server):
    """700 slow readers of a stored file, where a process may open 1,024."""
    name = json.loads(order(server, "format=json", long_wav(120)).body)["id"]
    finished(server, name)
    held = []
    for _ in range(700):
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        connection.settimeout(5)
        connection.connect((HOST, server.port))
        connection.sendall(request(f"/jobs/{name}/result"))
        held.append(connection)
    time.sleep(5)
    reply = order(server, "duration_s=1", mp3(4), HONEST)
    assert reply.status == 202, reply.error_type()
    return f"{server.descriptors()} descriptors, the other's order {reply.status}"


FLAGS = {
    "job_bytes": ["--job-bytes", "20MB"],
    "callbacks": ["--callback-allow", "*", "--callback-private", "--callback-secret", "c2Vj" * 8],
}


def prepare(attack):
    """A folder for the jobs of each server, and its flags."""
    name = attack.__name__
    folder = scratch() / name
    folder.mkdir()
    disk = {"full_disk": folder, "read_only": folder / "store"}.get(name)
    if disk:
        disk.mkdir(exist_ok=True)
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=24m", "none", disk], check=True)
        atexit.register(subprocess.run, ["umount", "-l", disk])
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    few = 1024 if name == "few_files" else most
    resource.setrlimit(resource.RLIMIT_NOFILE, (few, most))
    flags = ["--storage", f"file://{disk}"] if name == "read_only" else FLAGS.get(name, [])
    return flags, {"BAILANDO_DATA_DIR": str(folder)}


if __name__ == "__main__":
    attacks = [job_bytes, job_list, events, hung_orders, damaged, callbacks, ranges, guesses]
    as_root = [full_disk, read_only] if os.geteuid() == 0 else []
    run(18, __doc__, [*attacks, long_songs, coded, result_streams, few_files, *as_root], prepare)
