#!/usr/bin/env python3
"""What librosa and PyTorch take for what `bailando bench` measures, on the same machine.

    benches/baseline/baseline.py SONG [--model-dir DIR] [-o OUT.json]

Where librosa or PyTorch is missing, the first run makes a virtual environment beside this file (.venv)
and starts again in it. Stages: one thread, median of several runs. Codes: a transformer of
the model's size with fused attention that computes its whole window for every code, as the published
sampling does; random weights, which cost the same.
"""

import argparse
import importlib.util
import json
import os
import pathlib
import statistics
import subprocess
import sys
import time

HERE = pathlib.Path(__file__).resolve().parent
VENV = HERE / ".venv"
PACKAGES = ["librosa==0.11.0", "soundfile", "soxr", "torch"]
RUNS = 5


def in_environment():
    """Starts again in the environment, which is made first, unless this one has all that is needed."""
    python = VENV / "bin" / "python"
    found = [importlib.util.find_spec(name) for name in ("librosa", "torch")]
    if all(found) or pathlib.Path(sys.prefix) == VENV:
        return
    if not (VENV / "complete").exists():
        subprocess.check_call([sys.executable, "-m", "venv", str(VENV)])
        install = [str(python), "-m", "pip", "install", "--quiet"]
        index = os.environ.get("TORCH_INDEX")  # a mirror of the CPU builds, if there is one
        subprocess.check_call(install + (["--extra-index-url", index] if index else []) + PACKAGES)
        (VENV / "complete").touch()
    os.execv(python, [str(python), *sys.argv])


def median_seconds(work, runs=RUNS):
    work()
    times = []
    for _ in range(runs):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return statistics.median(times)


def features(signal, rate):
    """The 438 columns: mel, MFCC and slopes, constant-Q chroma, onset strength, beats, tempogram."""
    import librosa
    import numpy as np

    hop = 512
    harmonic, percussive = librosa.effects.hpss(signal)
    mel = librosa.feature.melspectrogram(y=signal, sr=rate, hop_length=hop)
    mfcc = librosa.feature.mfcc(S=librosa.power_to_db(mel), n_mfcc=20)
    octaves = 7 if rate > 15_360 else 5
    chroma = librosa.feature.chroma_cqt(y=harmonic, sr=rate, hop_length=hop, n_octaves=octaves)
    onset = librosa.onset.onset_strength(y=percussive, sr=rate, hop_length=hop)
    tempogram = librosa.feature.tempogram(onset_envelope=onset, sr=rate, hop_length=hop)
    _, beats = librosa.beat.beat_track(onset_envelope=onset, sr=rate, hop_length=hop)
    return np.concatenate([mfcc, librosa.feature.delta(mfcc), chroma, tempogram]), beats


def stages(song):
    import librosa

    times = {}
    for rate in (3840, 30720):
        load = lambda: librosa.load(song, sr=rate)[0]
        times[f"decode_resample_{rate}"] = median_seconds(load)
        signal = load()
        times[f"features_{rate}"] = median_seconds(lambda: features(signal, rate))
    return times


def seconds_of_a_code(manifest, threads):
    import torch
    from torch import nn
    from torch.nn.functional import gelu, scaled_dot_product_attention

    torch.set_num_threads(threads)
    sizes = manifest["gpt"]
    channels, heads, layers = sizes["channels"], sizes["heads"], sizes["layers"]
    window, columns = sizes["context"], manifest["features"]["columns"]
    vocabulary = manifest["vocabulary"]

    class Block(nn.Module):
        def __init__(self):
            super().__init__()
            self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(2)])
            self.attention = nn.Linear(channels, 3 * channels)
            self.projection = nn.Linear(channels, channels)
            self.wide = nn.Linear(channels, 4 * channels)
            self.narrow = nn.Linear(4 * channels, channels)

        def forward(self, hidden, mask):
            batch, tokens, _ = hidden.shape
            split = lambda part: part.view(batch, tokens, heads, -1).transpose(1, 2)
            parts = self.attention(self.norms[0](hidden)).chunk(3, dim=-1)
            mixed = scaled_dot_product_attention(*map(split, parts), attn_mask=mask)
            hidden = hidden + self.projection(mixed.transpose(1, 2).reshape(batch, tokens, channels))
            return hidden + self.narrow(gelu(self.wide(self.norms[1](hidden))))

    class Gpt(nn.Module):
        def __init__(self):
            super().__init__()
            self.music = nn.Linear(columns, channels)
            self.upper = nn.Embedding(vocabulary["upper"], channels)
            self.lower = nn.Embedding(vocabulary["lower"], channels)
            self.blocks = nn.ModuleList([Block() for _ in range(layers)])
            self.norm = nn.LayerNorm(channels)
            self.heads = nn.ModuleList([nn.Linear(channels, n) for n in vocabulary.values()])

        def forward(self, music, upper, lower, mask):
            streams = [self.music(music), self.upper(upper), self.lower(lower)]
            hidden = torch.cat(streams, dim=1)
            for block in self.blocks:
                hidden = block(hidden, mask)
            hidden = self.norm(hidden)
            return self.heads[0](hidden[:, 2 * window - 1]), self.heads[1](hidden[:, 3 * window - 1])

    gpt = Gpt().eval()
    step = torch.arange(3 * window) % window
    mask = step[None, :] <= step[:, None]
    codes = torch.zeros(1, window, dtype=torch.long)
    music = torch.randn(1, window, columns)
    with torch.inference_mode():
        return median_seconds(lambda: gpt(music, codes, codes, mask), runs=15)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("song")
    parser.add_argument("--model-dir", default=str(HERE.parents[1] / "models" / "default"))
    parser.add_argument("-o", "--output", default="baseline.json")
    arguments = parser.parse_args()
    import librosa
    import torch

    manifest = json.loads((pathlib.Path(arguments.model_dir) / "manifest.json").read_text())
    result = {
        "stages": stages(arguments.song),
        "code_s": {threads: seconds_of_a_code(manifest, threads) for threads in (1, 2)},
        "versions": {"librosa": librosa.__version__, "torch": torch.__version__},
    }
    text = json.dumps(result, indent=2)
    pathlib.Path(arguments.output).write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    in_environment()
    # Before anything that starts threads is imported.
    for variable in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
        os.environ.setdefault(f"{variable}_NUM_THREADS", "1")
    main()
