#!/usr/bin/env python3
"""Composes three songs of half a minute on which no model was trained, as WAV files.

Usage: scripts/compose-songs.py FOLDER [--form | --styles]

Hip-hop at 90 BPM, house at 128, drum and bass at 175. With --styles eleven songs instead, one for
each style of the default model and named after it. With --form six songs of about a minute, at 84
to 138 BPM, whose sections return: their form stands in their names, one letter for each section of
12 bars or of 8. Every run gives the same songs: noise and notes come from seeded generators. Needs
only Python's standard library.
"""

import array
import dataclasses
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


def wood_block(_noise):
    return tone(91, 0.1, 0.02, (0.35, 0.1))


@functools.lru_cache(maxsize=512)
def tone(midi, length, decay, overtones):
    step = 2 * math.pi * 440 * 2 ** ((midi - 69) / 12) / RATE
    return [
        level * sum(gain * math.sin(step * (k + 1) * i) for k, gain in enumerate(overtones))
        for i, level in enumerate(envelope(length, 0.008, decay))
    ]


class Song:
    """A song on a grid of sixteenths."""

    def __init__(self, bpm, bars=None, swing=0.0):
        """`swing` delays every second sixteenth by so many sixteenths."""
        self.sixteenth = 60 / bpm / 4
        self.swing = swing
        bar = self.sixteenth * SIXTEENTHS_PER_BAR
        self.samples = [0.0] * int((bars * bar if bars else SECONDS) * RATE)
        self.bars = bars or math.ceil(SECONDS / bar)

    def add(self, bar, place, sound, gain=1.0):
        late = self.swing * (place % 2)
        start = round((bar * SIXTEENTHS_PER_BAR + place + late) * self.sixteenth * RATE)
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


@dataclasses.dataclass
class Groove:
    """Places of a style's instruments, in sixteenths of a bar, or of two where one is above 15."""

    bpm: float
    kick: tuple
    snare: tuple
    hat: tuple
    bass: tuple
    chords: tuple
    roots: tuple = (45, 41, 43, 40)
    third: int = 3
    swing: float = 0.0
    wood: tuple = ()
    chord_seconds: float = 0.3


EIGHTHS = tuple(range(0, 16, 2))
SIXTEENTHS = tuple(range(16))
FOUR = (0, 4, 8, 12)
GROOVES = {
    "ballet-jazz": Groove(126, (0, 8), (12,), (0, 4, 7, 8, 12, 15), FOUR, (6, 15), (43, 48, 41, 46),
                          4, swing=0.33),
    "break": Groove(106, (0, 2, 10, 11), (4, 7, 9, 12, 15), EIGHTHS, (0, 2, 10), (0, 6)),
    "house": Groove(122, FOUR, (4, 12), (2, 6, 10, 14), (2, 6, 10, 13), (3, 6, 11, 14)),
    "krump": Groove(92, (0, 3, 6, 16, 22, 26), (8, 24), EIGHTHS, (0, 3, 6, 16, 22), (0, 24),
                    (38, 38, 39, 36), chord_seconds=0.8),
    "la-hiphop": Groove(114, (0, 3, 6, 10), (4, 12), EIGHTHS, (0, 3, 6, 10), (0, 7)),
    "lock": Groove(110, (0, 2, 10), (4, 12), SIXTEENTHS, (0, 2, 5, 7, 10, 13), (3, 6, 11), third=4),
    "middle-hiphop": Groove(96, (0, 7, 10), (4, 12), EIGHTHS, (0, 7, 10), (2, 10), swing=0.3),
    "pop": Groove(100, (0, 6, 8), (4, 12), EIGHTHS, (0, 2, 6, 8, 10, 14), (0, 8), (40, 40, 43, 45)),
    "salsa": Groove(180, (12, 14), (4,), FOUR, (6, 12), (0, 4, 6, 10, 14, 18, 22, 26, 30),
                    (45, 50, 52, 50), wood=(0, 6, 12, 20, 24)),
    "street-jazz": Groove(104, (0, 6, 10), (4, 12), SIXTEENTHS, (0, 6, 10), (0,), (41, 48, 43, 45),
                          4, chord_seconds=1.2),
    "waack": Groove(116, FOUR, (4, 12), SIXTEENTHS, (0, 2, 4, 6, 8, 10, 12, 14), (2, 10),
                    (45, 50, 43, 48), 4),
}


def grooving(style):
    groove = GROOVES[style]
    song, noise = Song(groove.bpm, swing=groove.swing), random.Random(style)
    drums = {kick: groove.kick, snare: groove.snare, hat: groove.hat, wood_block: groove.wood}
    for bar in range(song.bars):
        def of_bar(places):
            bars = 2 if max(places, default=0) > 15 else 1
            return [place % 16 for place in places if place // 16 == bar % bars]

        song.drum(bar, {sound: of_bar(places) for sound, places in drums.items()}, noise)
        root = groove.roots[bar // 2 % 4]
        for number, place in enumerate(of_bar(groove.bass)):
            note = root - 12 + (0, 7, 12, 7)[number % 4]
            song.add(bar, place, tone(note, 0.3, 0.18, (0.5, 0.2, 0.1)))
        for place in of_bar(groove.chords):
            for interval in (0, groove.third, 7, groove.third + 7):
                length = groove.chord_seconds
                song.add(bar, place, tone(root + 12 + interval, length, length / 2.5, (0.1, 0.05)))
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
    if len(sys.argv) not in (2, 3) or sys.argv[2:] not in ([], ["--form"], ["--styles"]):
        sys.exit(__doc__)
    folder = pathlib.Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    if "--styles" in sys.argv:
        for style in GROOVES:
            grooving(style).write(folder / f"{style}.wav")
        return
    if "--form" in sys.argv:
        for bpm, form in FORMS.items():
            formed(bpm, form).write(folder / f"{form}_{bpm}.wav")
        return
    songs = {"hip_hop_90": hip_hop, "house_128": house, "drum_and_bass_175": drum_and_bass}
    for name, compose in songs.items():
        compose().write(folder / f"{name}.wav")


if __name__ == "__main__":
    main()
