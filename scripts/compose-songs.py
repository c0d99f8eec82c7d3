#!/usr/bin/env python3
"""Composes three songs of half a minute on which no model was trained, as WAV files.

Usage: scripts/compose-songs.py FOLDER [--form]

Hip-hop at 90 BPM, house at 128, drum and bass at 175. With --form six songs of about a minute
instead, at 84 to 138 BPM, whose sections return: their form stands in their names, one letter for
each section of 12 bars or of 8. Every run gives the same songs: noise and notes come from seeded
generators. Needs only Python's standard library.
"""

import array
import functools
import math
import pathlib
import random
import sys
import wave

RATE = 22050
SECONDS = 30.0
SIXTEENTHS_PER_BAR = 16


def envelope(length, attack, decay):
    """Samples that rise for `attack` seconds and then fall by 1/e every `decay` seconds."""
    for i in range(int(length * RATE)):
        t = i / RATE
        yield min(t / attack, 1.0) * math.exp(-max(t - attack, 0.0) / decay)


def kick(_noise):
    phase, samples = 0.0, []
    for i, level in enumerate(envelope(0.25, 0.002, 0.07)):
        phase += 2 * math.pi * (48 + 110 * math.exp(-i / RATE / 0.025)) / RATE
        samples.append(0.9 * level * math.sin(phase))
    return samples


def snare(noise):
    tone = 2 * math.pi * 185 / RATE
    return [
        level * (0.45 * noise.uniform(-1, 1) + 0.3 * math.sin(tone * i))
        for i, level in enumerate(envelope(0.2, 0.001, 0.055))
    ]


def hat(noise, decay=0.02):
    samples, before = [], 0.0
    for level in envelope(5 * decay, 0.001, decay):
        now = noise.uniform(-1, 1)
        # The difference of neighbours is a simple high pass.
        samples.append(0.16 * level * (now - before))
        before = now
    return samples


@functools.lru_cache(maxsize=512)
def tone(midi, length, decay, overtones):
    step = 2 * math.pi * 440 * 2 ** ((midi - 69) / 12) / RATE
    return [
        level * sum(gain * math.sin(step * (k + 1) * i) for k, gain in enumerate(overtones))
        for i, level in enumerate(envelope(length, 0.008, decay))
    ]


class Song:
    """A song on a grid of sixteenths."""

    def __init__(self, bpm, bars=None):
        self.sixteenth = 60 / bpm / 4
        bar = self.sixteenth * SIXTEENTHS_PER_BAR
        self.samples = [0.0] * int((bars * bar if bars else SECONDS) * RATE)
        self.bars = bars or math.ceil(SECONDS / bar)

    def add(self, bar, place, sound, gain=1.0):
        start = round((bar * SIXTEENTHS_PER_BAR + place) * self.sixteenth * RATE)
        for i, sample in enumerate(sound[: max(len(self.samples) - start, 0)], start):
            self.samples[i] += gain * sample

    def drum(self, bar, drums, noise):
        for sound, places in drums.items():
            for place in places:
                self.add(bar, place, sound(noise))

    def write(self, path):
        loudest = max(abs(sample) for sample in self.samples)
        pcm = array.array("h", (round(28000 * sample / loudest) for sample in self.samples))
        if sys.byteorder == "big":
            pcm.byteswap()
        with wave.open(str(path), "wb") as file:
            file.setnchannels(1)
            file.setsampwidth(2)
            file.setframerate(RATE)
            file.writeframes(pcm.tobytes())


def hip_hop():
    song, noise = Song(90), random.Random(90)
    drums = {kick: (0, 7, 10), snare: (4, 12), hat: (0, 2, 4, 6, 8, 10, 12, 14, 15)}
    chords = [(57, 60, 64), (53, 57, 60), (50, 53, 57), (52, 56, 59)]
    for bar in range(song.bars):
        song.drum(bar, drums, noise)
        chord = chords[bar % 4]
        for place in (0, 7, 10):
            song.add(bar, place, tone(chord[0] - 24, 0.5, 0.25, (0.5, 0.1)))
        for note in chord:
            song.add(bar, 2, tone(note, 1.2, 0.5, (0.12, 0.05, 0.02)))
    return song


def house():
    song, noise = Song(128), random.Random(128)
    chords = [(60, 63, 67, 70), (58, 62, 65, 69), (56, 60, 63, 67), (55, 58, 62, 65)]
    for bar in range(song.bars):
        for beat in range(0, SIXTEENTHS_PER_BAR, 4):
            song.add(bar, beat, kick(noise))
            song.add(bar, beat + 2, hat(noise, 0.05))
        for place in (4, 12):
            song.add(bar, place, snare(noise), 0.8)
        chord = chords[bar // 2 % 4]
        for place in (2, 6, 10, 14):
            song.add(bar, place, tone(chord[0] - 24, 0.2, 0.12, (0.5, 0.2, 0.1)))
        for place in (3, 6, 11):
            for note in chord:
                song.add(bar, place, tone(note, 0.3, 0.1, (0.1, 0.06, 0.04, 0.02)))
    return song


def drum_and_bass():
    song, noise = Song(175), random.Random(175)
    drums = {kick: (0, 10), snare: (4, 12), hat: (0, 2, 4, 6, 7, 8, 10, 12, 14)}
    roots = (38, 38, 34, 36)
    for bar in range(song.bars):
        song.drum(bar, drums, noise)
        root = roots[bar // 2 % 4]
        for place in (0, 3, 6, 10):
            song.add(bar, place, tone(root, 0.35, 0.2, (0.5, 0.25, 0.15)))
        if bar % 2 == 0:
            for note in (24, 27, 31):
                song.add(bar, 0, tone(root + note, 2.5, 1.2, (0.08, 0.03)))
    return song


def section(song, letter, bars):
    """A section of its own chords, drums, bass and tune, the same for every letter of a song."""
    dice, noise = random.Random(f"{song.sixteenth} {letter}"), random.Random(letter)
    scale = (0, 2, 3, 5, 7, 8, 10)
    root = 45 + dice.randrange(12)
    degrees = [0] + dice.sample(range(1, 7), 3)
    drums = {
        kick: dice.choice([(0, 4, 8, 12), (0, 8), (0, 8, 10), (0, 7, 8)]),
        snare: (4, 12),
        hat: tuple(range(0, 16, dice.choice((2, 4)))),
    }
    bass = sorted({0, 8} | set(dice.sample(range(0, 16, 2), 2)))
    # A tune of two bars.
    tune = [(dice.randrange(32), dice.randrange(7)) for _ in range(dice.randrange(6, 12))]
    loud = dice.uniform(0.05, 0.12)
    for number, bar in enumerate(bars):
        def note(degree):
            octave, step = divmod(degrees[number // 2 % 4] + degree, 7)
            return root + 12 * octave + scale[step]

        song.drum(bar, drums, noise)
        for place in bass:
            song.add(bar, place, tone(note(0) - 12, 0.3, 0.2, (0.45, 0.15)))
        for degree in (0, 2, 4):
            song.add(bar, 0, tone(note(degree) + 12, 1.6, 0.8, (loud, loud / 2, loud / 4)))
        for place, degree in tune:
            if place // 16 == number % 2:
                lead = (1.5 * loud, loud, loud / 2)
                song.add(bar, place % 16, tone(note(degree) + 24, 0.4, 0.15, lead))


def formed(bpm, form):
    bars = 8 if len(form) > 3 else 12
    song = Song(bpm, bars * len(form))
    for number, letter in enumerate(form):
        section(song, letter, range(number * bars, (number + 1) * bars))
    return song


FORMS = {84: "aba", 96: "aba", 108: "abab", 120: "abcb", 128: "abab", 138: "abcab"}


def main():
    if len(sys.argv) not in (2, 3) or sys.argv[2:] not in ([], ["--form"]):
        sys.exit(__doc__)
    folder = pathlib.Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    if sys.argv[2:]:
        for bpm, form in FORMS.items():
            formed(bpm, form).write(folder / f"{form}_{bpm}.wav")
        return
    songs = {"hip_hop_90": hip_hop, "house_128": house, "drum_and_bass_175": drum_and_bass}
    for name, compose in songs.items():
        compose().write(folder / f"{name}.wav")


if __name__ == "__main__":
    main()
