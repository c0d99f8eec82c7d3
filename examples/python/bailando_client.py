"""A client of a bailando server, of the standard library alone: Python 3.9 or newer.

    python bailando_client.py generate song.mp3 -o dance.glb seed=7 duration_s=20
    python bailando_client.py stream song.mp3 duration_s=20
    python bailando_client.py job song.mp3 -o dance.bvh

Options are those of the server, as `name=value`; `BAILANDO_API_KEY` is sent where it is set.
"""

from __future__ import annotations

import argparse
import array
import base64
import http.client
import json
import os
import pathlib
import sys
import time
import urllib.parse
from collections.abc import Iterator
from typing import Any


class BailandoError(Exception):
    """An answer that is no dance. `kind` is for programs, `request_id` for reports; `status` is
    None where a dance failed after an answer had begun."""

    def __init__(self, status: int | None, body: dict[str, Any], retry_after: str | None = None):
        reason = body.get("error", "no reason given")
        super().__init__(f"{status}: {reason}" if status else reason)
        self.status = status
        self.kind = body.get("error_type")
        self.request_id = body.get("request_id")
        self.retry_after = float(retry_after) if retry_after else None


class Bailando:
    def __init__(self, url: str = "http://127.0.0.1:8080", key: str | None = None):
        self.url = urllib.parse.urlsplit(url)
        self.key = key

    def generate(self, song: pathlib.Path, out: pathlib.Path, **options: Any) -> dict[str, str]:
        """Writes the dance to `out`, in the format of its extension; returns the headers, among
        them `x-seed`, and `x-tail` for the clip that follows."""
        options.setdefault("format", out.suffix.lstrip("."))
        answer = self._post("/generate", song, options)
        _save(answer, out)
        return {name.lower(): value for name, value in answer.getheaders()}

    def stream(self, song: pathlib.Path, **options: Any) -> Iterator[dict[str, Any]]:
        """Yields the events of a dance while it is made: `start`, `frames` .., `done`.

        Positions come as `array('f')` of frames x joints x 3 metres.
        """
        options.setdefault("encoding", "base64")
        answer = self._post("/generate/stream", song, options, accept="application/x-ndjson")
        for line in answer:
            event = json.loads(line)
            if event["event"] == "error":
                raise BailandoError(None, event)
            for name in ("positions", "rotations", "root"):
                if isinstance(event.get(name), str):
                    event[name] = floats(event[name])
            yield event

    def job(self, song: pathlib.Path, out: pathlib.Path, **options: Any) -> None:
        """Orders the dance, waits for it, and writes it to `out`: for long songs."""
        options.setdefault("format", out.suffix.lstrip("."))
        ordered = self._post("/jobs", song, options)
        place = ordered.getheader("location")
        ordered.read()
        while True:
            job = json.load(self._request("GET", place))
            if job["state"] == "done":
                break
            if job["state"] not in ("queued", "running"):
                raise BailandoError(None, job["error"])
            print(f"{job['codes_done']} of {job['codes_total']} codes", file=sys.stderr)
            time.sleep(0.5)
        _save(self._request("GET", f"{place}/result?format={options['format']}"), out)
        self._request("DELETE", place).read()

    def _post(self, path: str, song: pathlib.Path, options: dict, accept: str = "*/*"):
        query = urllib.parse.urlencode(options)
        with open(song, "rb") as body:
            # The format of a song is recognised by its content, so any audio type will do.
            kind = {"content-type": "audio/*", "accept": accept}
            kind["content-length"] = str(os.path.getsize(song))
            return self._request("POST", f"{path}?{query}", body, kind)

    def _request(self, method: str, path: str, body=None, headers=None, patience: int = 5):
        secure = self.url.scheme == "https"
        connect = http.client.HTTPSConnection if secure else http.client.HTTPConnection
        connection = connect(self.url.netloc, timeout=300)
        headers = dict(headers or {})
        if self.key:
            headers["authorization"] = f"Bearer {self.key}"
        connection.request(method, self.url.path.rstrip("/") + path, body, headers)
        answer = connection.getresponse()
        if answer.status < 400:
            return answer
        text = answer.read()
        try:
            reason = json.loads(text)
        except ValueError:
            reason = {"error": text.decode(errors="replace")}
        error = BailandoError(answer.status, reason, answer.getheader("retry-after"))
        # Busy (429) or restarting (503): the server says how long to wait.
        if error.retry_after is None or patience == 0:
            raise error
        time.sleep(error.retry_after)
        if body is not None:
            body.seek(0)
        return self._request(method, path, body, headers, patience - 1)


def floats(text: str) -> array.array:
    """Decodes base64 of little-endian float32."""
    values = array.array("f", base64.b64decode(text))
    if sys.byteorder == "big":
        values.byteswap()
    return values


def _save(answer: http.client.HTTPResponse, out: pathlib.Path) -> None:
    with open(out, "wb") as file:
        while chunk := answer.read(1 << 16):
            file.write(chunk)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("command", choices=["generate", "stream", "job"])
    parser.add_argument("song", type=pathlib.Path)
    parser.add_argument("options", nargs="*", help="name=value, as the server knows them")
    parser.add_argument("-o", "--out", type=pathlib.Path, default=pathlib.Path("dance.bvh"))
    parser.add_argument("--server", default="http://127.0.0.1:8080")
    args = parser.parse_intermixed_args()
    options = dict(option.split("=", 1) for option in args.options)
    client = Bailando(args.server, os.environ.get("BAILANDO_API_KEY"))
    started = time.monotonic()
    if args.command == "generate":
        headers = client.generate(args.song, args.out, **options)
        print(f"{args.out}: seed {headers['x-seed']}")
    elif args.command == "job":
        client.job(args.song, args.out, **options)
        print(args.out)
    else:
        for event in client.stream(args.song, **options):
            after = time.monotonic() - started
            if event["event"] == "frames":
                x, y, z = event["positions"][:3]
                print(f"{after:.2f} s: frames from {event['first']}, {event['count']} of them; "
                      f"pelvis at {x:.2f} {y:.2f} {z:.2f} m")
            else:
                print(f"{after:.2f} s: {event['event']}, {event['frames']} frames")


if __name__ == "__main__":
    try:
        main()
    except BailandoError as error:
        sys.exit(f"error: {error}")
