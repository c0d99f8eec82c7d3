#!/usr/bin/env python3
"""Row 13: API keys: none 401, a wrong one 401, the right one 200, and the key found nowhere.

The key comes by the environment once, and once by a file. Afterwards it is looked for in the log
(with everything that the server's own code can say), in the command line, in `--help`, and in every
answer. Probes, metrics and documentation need no key.
"""

import base64
import secrets
import subprocess
from pathlib import Path

from client import ask, dance_problem
from harness import ROOT, Server, Verdict, arguments, clean_environment, scratch
from songs import mp3

OPEN = ["/health", "/ready", "/info", "/metrics", "/api-doc/openapi.json", "/docs", "/docs/"]
MEDIA = "content-type: audio/mpeg"
QUERY = "?candidates=1&format=json"
WORKING = [
    ("POST", "/generate" + QUERY),
    ("POST", "/generate/stream?candidates=1"),
    ("POST", "/jobs" + QUERY),
    ("GET", "/codes"),
    ("GET", "/codes/1/1"),
    ("GET", "/jobs/0"),
    ("GET", "/jobs/0/result"),
    ("DELETE", "/jobs/0"),
]


def forms(key):
    """How a key could be written down."""
    return {
        "as it is": key.encode(),
        "reversed": key[::-1].encode(),
        "base64": base64.b64encode(key.encode()).rstrip(b"="),
        "hexadecimal": key.encode().hex().encode(),
        "as a list of bytes": ", ".join(map(str, key.encode())).encode(),
        # Even a half of it is too much.
        "its first half": key[: len(key) // 2].encode(),
        "its second half": key[len(key) // 2 :].encode(),
    }


class Trial:
    """A server that asks for a key, and all that it has said."""

    def __init__(self, server, key, way):
        self.server, self.key, self.way = server, key, way
        self.said, self.problems = {}, []

    def ask(self, method, path, headers=()):
        body = mp3(2) if method == "POST" else None
        reply = ask(self.server.port, method, path, body, [*headers, *([MEDIA] if body else [])])
        said = self.said.setdefault(path, [])
        said.append(
            reply.body
            + "\n".join(f"{name}: {value}" for name, value in reply.headers.items()).encode()
        )
        return reply

    def refused(self):
        """Statuses of the routes that work: without a key, with wrong ones."""
        key = self.key
        wrong = {
            "no key": [],
            "empty": ["authorization: Bearer "],
            "another": [f"authorization: Bearer {secrets.token_hex(16)}"],
            "shorter": [f"x-api-key: {key[:-1]}"],
            "longer": [f"x-api-key: {key}0"],
            "in capitals": [f"authorization: Bearer {key.upper()}"],
            "another scheme": [f"authorization: Basic {key}"],
            "in the query": [],
        }
        statuses = {}
        for name, headers in wrong.items():
            for method, path in WORKING:
                asked = (
                    path + ("&" if "?" in path else "?") + f"api_key={key}"
                    if name == "in the query"
                    else path
                )
                reply = self.ask(method, asked, headers)
                statuses.setdefault(name, set()).add(reply.status)
                if reply.status == 401 and (
                    reply.refusal_problem() or "www-authenticate" not in reply.headers
                ):
                    self.problems.append(f"{self.way}, {name}, {path}: {reply.body[:100]!r}")
        return statuses

    def let_in(self):
        """Statuses of a dance with the right key, and what else goes wrong with it."""
        statuses = []
        for headers in ([f"Authorization: Bearer {self.key}"], [f"X-API-Key: {self.key}"]):
            reply = self.ask("POST", "/generate" + QUERY, headers)
            statuses.append(reply.status)
            if reply.status == 200 and (problem := dance_problem(reply)):
                self.problems.append(f"{self.way}: {problem}")
            others = [self.ask(method, path, headers).status for method, path in WORKING[1:]]
            if 401 in others:
                self.problems.append(f"{self.way}: 401 with the right key: {others}")
        # Errors that may quote what was sent.
        self.ask("POST", "/generate?fps=25", [f"x-api-key: {self.key}"])
        self.ask("GET", "/nowhere", [f"x-api-key: {self.key}"])
        return statuses

    def probes(self):
        return {path: self.ask("GET", path).status for path in OPEN}

    def found(self, more):
        """Where the key is found."""
        places = {path: b"\n".join(said) for path, said in self.said.items()}
        places |= {"log": self.server.log_path.read_bytes(), **more}
        return [
            f"{self.way}: {place}: {form}"
            for place, text in places.items()
            for form, written in forms(self.key).items()
            if written in text
        ]


def trial(options, verdict, way, flags, environment, key):
    with Server(options, *flags, env={"RUST_LOG": "debug,bailando=trace", **environment}) as server:
        trial = Trial(server, key, way)
        probes = trial.probes()
        wrong = {
            path: status for path, status in probes.items() if status not in (200, 303, 307, 308)
        }
        verdict.check(
            f"{way}: probes and documentation without a key",
            wrong or f"{len(probes)} answered",
            "no refusals",
            not wrong,
        )
        for name, statuses in trial.refused().items():
            verdict.equal(f"{way}, {name}: statuses", sorted(statuses), [401])
        verdict.equal(f"{way}, right key: statuses", trial.let_in(), [200, 200])
        trial.probes()
        command_line = Path(f"/proc/{server.process.pid}/cmdline").read_bytes()
        server.stop(verdict)
        more = {"command line": command_line, "help": help_text(options, environment)}
        log = server.log()
        verdict.note(
            f"{way}: looked through {sum(map(len, trial.said.values()))} answers of {len(trial.said)} "
            f"routes and {len(log.splitlines())} lines of log"
        )
        verdict.problems(f"{way}: places where the key was found", trial.found(more))
        verdict.problems(f"{way}: other faults", trial.problems)


def help_text(options, environment):
    done = subprocess.run(
        [options.binary, "serve", "--help"],
        cwd=ROOT,
        env=clean_environment(**environment),
        capture_output=True,
        timeout=20,
        check=True,
    )
    return done.stdout + done.stderr


def main():
    options = arguments(__doc__)
    verdict = Verdict(13, options.quick)
    by_environment, first, second = (f"key{secrets.token_hex(20)}" for _ in range(3))
    trial(options, verdict, "environment", [], {"BAILANDO_API_KEY": by_environment}, by_environment)
    file = scratch() / "keys.txt"
    file.write_text(f"{first}\n{second}\n")
    file.chmod(0o600)
    flags = ["--api-key-file", file, "--json-output"]
    trial(options, verdict, "file", flags, {}, second)
    verdict.finish()


if __name__ == "__main__":
    main()
