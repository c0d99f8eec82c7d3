#!/usr/bin/env python3
"""Row 12: model directories that cannot be served.

Missing, empty, cut off, mixed up: each time `bailando serve` must end by itself within 2 s, with an
exit code other than 0 and exactly one line on stderr. The damaged directories are copies of
models/default.
"""

import hashlib
import json
import shutil
import signal
import subprocess
import time

from harness import (
    ROOT,
    Verdict,
    arguments,
    clean_environment,
    free_port,
    scratch,
    spawn,
    times,
)

WITHIN = 2.0
DEFAULT = ROOT / "models/default"
# Tests have it: another model's manifest, of an age when models were larger.
OTHER_MANIFEST = ROOT / "tests/fixtures/model/manifest_of_the_first_model.json"


def change_manifest(folder, change):
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest, indent=2))


def cut(folder, name, keep=0.5):
    path = folder / name
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])


def agree(folder, name):
    """Makes the manifest agree with the file as it is now."""
    data = (folder / name).read_bytes()
    entry = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    change_manifest(folder, lambda manifest: manifest["files"][name].update(entry))


def cut_and_agree(folder, name):
    cut(folder, name)
    agree(folder, name)


def wrong_hash(folder):
    def change(manifest):
        entry = manifest["files"]["decoder.onnx"]
        entry["sha256"] = entry["sha256"][::-1]

    change_manifest(folder, change)


def exchanged(folder):
    """The files of a model under each other's names, and a manifest that agrees."""
    gpt, decoder = folder / "gpt.onnx", folder / "decoder.onnx"
    gpt.rename(folder / "third")
    decoder.rename(gpt)
    (folder / "third").rename(decoder)
    agree(folder, "gpt.onnx")
    agree(folder, "decoder.onnx")


def other_shapes(folder):
    """The manifest of a model of the same kind with other sizes."""

    def change(manifest):
        manifest["vocabulary"] = {"upper": 512, "lower": 512}
        manifest["gpt"]["channels"] = 768
        manifest["gpt"]["heads"] = 12

    change_manifest(folder, change)


DAMAGES = {
    "missing": shutil.rmtree,
    "empty": lambda folder: [path.unlink() for path in folder.iterdir()],
    "a file instead": lambda folder: (shutil.rmtree(folder), folder.write_text("a model")),
    "no manifest": lambda folder: (folder / "manifest.json").unlink(),
    "empty manifest": lambda folder: (folder / "manifest.json").write_text(""),
    "cut manifest": lambda folder: cut(folder, "manifest.json"),
    "manifest that is no text": lambda folder: (folder / "manifest.json").write_bytes(
        b"\xff\xfe\0" * 100
    ),
    "manifest of another format": lambda folder: change_manifest(
        folder, lambda m: m.update(format_version=999)
    ),
    "no gpt.onnx": lambda folder: (folder / "gpt.onnx").unlink(),
    "cut gpt.onnx": lambda folder: cut(folder, "gpt.onnx"),
    "cut decoder.onnx": lambda folder: cut(folder, "decoder.onnx"),
    "empty gpt.onnx": lambda folder: cut(folder, "gpt.onnx", keep=0),
    "cut gpt.onnx, the manifest agrees": lambda folder: cut_and_agree(folder, "gpt.onnx"),
    "cut decoder.onnx, the manifest agrees": lambda folder: cut_and_agree(folder, "decoder.onnx"),
    "empty gpt.onnx, the manifest agrees": lambda folder: (
        cut(folder, "gpt.onnx", 0),
        agree(folder, "gpt.onnx"),
    ),
    "wrong hash": wrong_hash,
    "files exchanged, the manifest agrees": exchanged,
    "manifest of other sizes": other_shapes,
    "manifest of another model": lambda folder: shutil.copy(
        OTHER_MANIFEST, folder / "manifest.json"
    ),
}


def start(options, folder):
    """Exit code, seconds, and what was said on stderr. A server that does not end is ended."""
    started = time.monotonic()
    process = spawn(
        [str(options.binary), "serve", "--port", str(free_port()), "--model-dir", str(folder)],
        cwd=ROOT,
        env=clean_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        _, said = process.communicate(timeout=20)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        _, said = process.communicate()
    return process.returncode, time.monotonic() - started, said.decode(errors="replace")


def main():
    options = arguments(__doc__)
    verdict = Verdict(12, options.quick)
    problems, late, seconds = [], [], []
    for number, (name, damage) in enumerate(DAMAGES.items()):
        folder = scratch() / f"model-{number}"
        shutil.copytree(DEFAULT, folder)
        damage(folder)
        code, took, said = start(options, folder)
        lines = said.splitlines()
        shown = said.replace(str(folder), "MODEL").strip()
        verdict.note(f"{name}: exit code {code} after {took:.2f} s: {shown[:300]}")
        seconds.append(took)
        if code <= 0:
            problems.append(f"{name}: exit code {code}")
        if len(lines) != 1 or not lines[0].strip():
            problems.append(f"{name}: {len(lines)} lines on stderr")
        if "panicked" in said:
            problems.append(f"{name}: a panic")
        if took > WITHIN:
            late.append(f"{name}: {took:.1f} s")
        shutil.rmtree(folder, ignore_errors=True)
    verdict.note(times(seconds))
    verdict.problems("starts that did not end with one line and a code above 0", problems)
    verdict.problems(f"starts that ended after more than {WITHIN:g} s", late)
    verdict.finish()


if __name__ == "__main__":
    main()
