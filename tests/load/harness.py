"""What the load tests share: a server to test, its figures, verdicts.

Nothing beyond the standard library. Everything stays on the loopback, and every process that is
started ends with the test, whichever way it ends.
"""

import argparse
import atexit
import contextlib
import ctypes
import functools
import http.client
import json
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from client import HOST, ask

ROOT = Path(__file__).resolve().parents[2]
# Whatever a test keeps: files that broke something, the tools' own output.
KEPT = ROOT / "target/load"
MIB = 1024 * 1024
PR_SET_PDEATHSIG = 1
# Found before any fork: a child of a process with threads should do as little as it can.
LIBC = ctypes.CDLL(None)


# What is asked of a test, and what it says.


def arguments(description, extend=None):
    """The options that every test has; `extend` adds its own to the parser."""
    parser = argparse.ArgumentParser(description=description.strip().splitlines()[0])
    parser.add_argument(
        "--binary",
        type=Path,
        default=os.environ.get("BAILANDO_BINARY") or ROOT / "target/release/bailando",
        help="the program to test [env: BAILANDO_BINARY] [default: target/release/bailando]",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a short run that shows that the test works; its figures do not count",
    )
    if extend:
        extend(parser)
    options = parser.parse_args()
    options.binary = Path(options.binary).resolve()
    if not options.binary.is_file():
        sys.exit(f"there is no {options.binary}: make build")
    # A test that is told to stop cleans up as one that ends by itself.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    signal.signal(signal.SIGHUP, lambda *_: sys.exit(129))
    # Long runs are watched through pipes and files.
    sys.stdout.reconfigure(line_buffering=True)
    return options


class Verdict:
    """Prints a line for every figure, and ends the test with 1 if one falls short."""

    def __init__(self, row, quick):
        self.row, self.quick, self.failed = row, quick, 0
        if quick:
            print(f"row {row}: QUICK RUN: it shows that the test works, its figures do not count")

    def check(self, name, figure, limit, holds, timed=False):
        """A figure, what is asked of it, and whether that holds. A quick run is too short to fail for
        a `timed` one: how fast or how much, which needs samples and a quiet machine."""
        excused = timed and self.quick
        self.failed += not holds and not excused
        word = "ok" if holds else "not met, quick run" if excused else "FAILED"
        print(f"row {self.row}: {name}: {figure} ({limit}) {word}")
        return holds

    def at_most(self, name, value, limit, unit="", timed=False):
        holds = value is not None and value <= limit
        return self.check(
            name, _figure(value, unit), f"at most {_figure(limit, unit)}", holds, timed
        )

    def at_least(self, name, value, limit, unit="", timed=False):
        holds = value is not None and value >= limit
        return self.check(
            name, _figure(value, unit), f"at least {_figure(limit, unit)}", holds, timed
        )

    def equal(self, name, value, wanted, unit=""):
        return self.check(
            name, _figure(value, unit), f"must be {_figure(wanted, unit)}", value == wanted
        )

    def note(self, text):
        """Something to know that no limit belongs to."""
        print(f"row {self.row}: {text}")

    def problems(self, name, problems, shown=5):
        """There must be none; the first few are told."""
        for problem in problems[:shown]:
            self.note(f"  {problem}")
        return self.equal(name, len(problems), 0)

    def finish(self):
        word = "FAILED" if self.failed else "ok"
        quick = " (quick run, does not count)" if self.quick else ""
        print(f"row {self.row}: {word}{quick}")
        sys.exit(1 if self.failed else 0)


def _figure(value, unit):
    if isinstance(value, float):
        value = f"{value:.3f}".rstrip("0").rstrip(".") if abs(value) < 100 else f"{value:.0f}"
    return f"{value} {unit}".rstrip()


def percentile(values, percent):
    """The smallest value that so many percent of the values do not exceed."""
    ordered = sorted(values)
    if not ordered:
        return math.nan
    return ordered[max(0, math.ceil(percent / 100 * len(ordered)) - 1)]


def times(seconds):
    """A few figures of many times, in milliseconds."""
    p50, p99, most = (1000 * percentile(seconds, percent) for percent in (50, 99, 100))
    return f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, longest {most:.1f} ms, {len(seconds)} samples"


# Processes.


def die_with_parent():
    """Called in a process that must not outlive the one that started it."""
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def spawn(command, **settings):
    """A process that does not outlive the test. To be called from the main thread."""
    process = subprocess.Popen(command, preexec_fn=die_with_parent, **settings)
    atexit.register(_end, process)
    return process


def _end(process):
    with contextlib.suppress(OSError):
        process.kill()
    process.wait()


def clean_environment(**more):
    """The environment without settings of whoever runs the test."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.upper().startswith("BAILANDO_")
        and not name.upper().endswith("_PROXY")
        and name != "RUST_LOG"
    }
    return kept | more


@functools.cache
def scratch():
    """A folder that is gone when the test ends."""
    folder = Path(tempfile.mkdtemp(prefix="bailando-load-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def keep(name, content):
    """Keeps a file for whoever looks at a failure; says where."""
    KEPT.mkdir(parents=True, exist_ok=True)
    (KEPT / name).write_bytes(content)
    return (KEPT / name).relative_to(ROOT)


def need_hey():
    """The load generator that the tests use."""
    hey = shutil.which("hey")
    if hey is None:
        sys.exit(
            "hey is missing, a load generator. Debian, Ubuntu: sudo apt-get install hey; "
            "elsewhere: https://github.com/rakyll/hey"
        )
    return hey


def free_port():
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


class Server:
    """A server of its own for a test, started with some flags; ready when it is made."""

    def __init__(self, options, *flags, env=None):
        self.port = free_port()
        self.log_path = scratch() / f"server-{self.port}.log"
        command = [options.binary, "serve", "--host", HOST, "--port", str(self.port), *flags]
        with self.log_path.open("wb") as log:
            self.process = spawn(
                list(map(str, command)),
                cwd=ROOT,
                # Jobs in memory, unless a test names a folder.
                env=clean_environment(**{"BAILANDO_DATA_DIR": "none"} | (env or {})),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        self._wait_until_ready()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        _end(self.process)

    def _wait_until_ready(self, seconds=60):
        until = time.monotonic() + seconds
        while time.monotonic() < until and self.is_alive():
            with contextlib.suppress(OSError, http.client.HTTPException):
                if self.get("/ready", timeout=5).status == 200:
                    return
            time.sleep(0.02)
        self._give_up("the server does not become ready")

    def _give_up(self, why):
        sys.exit(f"{why}:\n{self.log()[-4000:]}")

    def is_alive(self):
        return self.process.poll() is None

    def log(self):
        return self.log_path.read_text(errors="replace")

    # What it answers.

    def get(self, path, headers=(), timeout=30):
        return ask(self.port, "GET", path, headers=headers, timeout=timeout)

    def post(self, path, body, headers=("content-type: application/octet-stream",), timeout=150):
        return ask(self.port, "POST", path, body, headers, timeout)

    def limits(self):
        return json.loads(self.get("/info").body)["limits"]

    def metrics(self):
        return Metrics(self.get("/metrics").body.decode())

    def documented(self, method, path):
        """Status codes that the OpenAPI document names for a route."""
        document = json.loads(self.get("/api-doc/openapi.json").body)
        return {int(status) for status in document["paths"][path][method.lower()]["responses"]}

    # What the operating system knows of it.

    def _status(self, field):
        text = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(rf"^{field}:\s+(\d+)", text, re.MULTILINE)[1])

    def rss(self):
        """Bytes of memory that it has now."""
        return 1024 * self._status("VmRSS")

    def peak_rss(self):
        """The most that it has had since its start or the last `forget_peak`."""
        return 1024 * self._status("VmHWM")

    def forget_peak(self):
        Path(f"/proc/{self.process.pid}/clear_refs").write_text("5")

    def threads(self):
        return self._status("Threads")

    def descriptors(self):
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))

    def cpu_seconds(self):
        text = Path(f"/proc/{self.process.pid}/stat").read_text()
        fields = text.rpartition(") ")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    # How it ends.

    def kill(self):
        """As a power cut would, as far as a process notices."""
        self.process.kill()
        self.process.wait()

    def terminate(self):
        self.process.send_signal(signal.SIGTERM)

    def wait(self, timeout):
        """Its exit code; None if it does not end in time."""
        try:
            return self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def stop(self, verdict, timeout=35):
        """Tells it to stop; nothing that was done to it may keep it from ending well."""
        alive = self.is_alive()
        verdict.check("the server has lived through it", "yes" if alive else "no", "must", alive)
        if alive:
            self.terminate()
        code = self.wait(timeout)
        if not verdict.equal("exit code after SIGTERM", code, 0):
            verdict.note(f"  end of its log:\n{self.log()[-2000:]}")
        return code


class Metrics:
    """A scrape of `/metrics`."""

    LINE = re.compile(r"^(\w+)(?:\{(.*)\})? (\S+)$")
    LABEL = re.compile(r'(\w+)="([^"]*)"')

    def __init__(self, text):
        self.samples = []
        for line in text.splitlines():
            if not line.startswith("#") and (found := self.LINE.match(line)):
                labels = dict(self.LABEL.findall(found[2] or ""))
                self.samples.append((found[1], labels, float(found[3])))

    def of(self, name, **labels):
        """Labels and value of all samples with a name and at least these labels."""
        wanted = labels.items()
        return [
            (has, value)
            for found, has, value in self.samples
            if found == name and wanted <= has.items()
        ]

    def sum(self, name, **labels):
        return sum(value for _, value in self.of(name, **labels))

    def buckets(self, name, before=None):
        """Counts of a histogram by upper bound, without what an earlier scrape had already."""

        def counts(metrics):
            return {float(labels["le"]): value for labels, value in metrics.of(f"{name}_bucket")}

        new, old = counts(self), counts(before) if before else {}
        result, below = {}, 0
        for bound in sorted(new):
            upto = new[bound] - old.get(bound, 0)
            result[bound] = upto - below
            below = upto
        return result

    def largest_bucket(self, name, before=None):
        """Upper bound of the highest bucket that holds anything; None if none does."""
        return max(
            (bound for bound, count in self.buckets(name, before).items() if count), default=None
        )
