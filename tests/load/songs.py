"""Audio files for the load tests: ours, longer ones made of ours, and bombs.

Nothing here needs a codec.
"""

import functools
import struct

from harness import ROOT

AUDIO = ROOT / "tests/fixtures/audio"
MEDIA = {
    "flac": "audio/flac",
    "m4a": "audio/mp4",
    "mp3": "audio/mpeg",
    "ogg": "audio/ogg",
    "wav": "audio/wav",
}
FLAC_BLOCK = 65_535


def fixture(name):
    """One of our songs: demo.flac, .m4a, .mp3, .ogg (30 s each), demo_44k1_8s.wav."""
    return (AUDIO / name).read_bytes()


def wav(channels, rate, data, bits=16, declared=None):
    """A WAV file with these fields in its head, whether they make sense or not."""
    declared = len(data) if declared is None else declared
    block = channels * bits // 8 & 0xFFFF
    return (
        b"RIFF"
        + struct.pack("<I", min(declared + 36, 0xFFFFFFFF))
        + b"WAVEfmt "
        + struct.pack("<IHHIIHH", 16, 1, channels, rate, rate * block & 0xFFFFFFFF, block, bits)
        + b"data"
        + struct.pack("<I", declared)
        + data
    )


@functools.cache
def mp3(seconds):
    """An MP3 of so many seconds: frames of a song of ours, again and again where that is shorter."""
    frames = _mp3_frames()
    per_second = 44_100 / 1152
    wanted = round(seconds * per_second)
    return b"".join(frames[number % len(frames)] for number in range(wanted))


@functools.cache
def _mp3_frames():
    data = fixture("demo.mp3")
    sizes = [data[6 + i] for i in range(4)]
    at = 10 + (sizes[0] << 21 | sizes[1] << 14 | sizes[2] << 7 | sizes[3])
    rates = [0, 32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320, 0]
    frames = []
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] & 0xE0 == 0xE0:
        length = 144_000 * rates[data[at + 2] >> 4] // 44_100 + (data[at + 2] >> 1 & 1)
        frames.append(data[at : at + length])
        at += length
    # The first frame says how long the whole file is, which is no longer true.
    return tuple(frame for frame in frames if b"Xing" not in frame and b"Info" not in frame)


@functools.cache
def long_wav(seconds):
    """A WAV of so many seconds: a song of ours, again and again."""
    data = fixture("demo_44k1_8s.wav")[44:]
    wanted = 2 * round(seconds * 44_100)
    return wav(1, 44_100, (data * (wanted // len(data) + 1))[:wanted])


def silent_flac(rate, channels, frames, declared=None):
    """A FLAC file of digital silence in which every block is one constant: hours in a few hundred KiB.

    `declared` is the length that its head tells, where that is not the truth; 0 means unknown.
    """
    declared = frames if declared is None else declared
    packed = rate << 44 | (channels - 1) << 41 | 15 << 36 | declared
    # STREAMINFO, the last and only block of metadata: block sizes, frame sizes (unknown), what the
    # sound is, no MD5.
    parts = [
        b"fLaC\x80\0\0\x22",
        struct.pack(">HH", FLAC_BLOCK, FLAC_BLOCK),
        bytes(6),
        packed.to_bytes(8, "big"),
        bytes(16),
    ]
    whole, rest = divmod(frames, FLAC_BLOCK)
    for number, block in enumerate([FLAC_BLOCK] * whole + [rest] * (rest > 0)):
        parts.append(_flac_frame(number, block, channels))
    return b"".join(parts)


def _flac_frame(number, block, channels):
    # Fixed block size, which follows the number in 16 bits; the rate is that of STREAMINFO; channels
    # for themselves, 16 bits a sample. The number is coded as UTF-8 codes characters.
    frame = b"\xff\xf8\x70" + bytes([(channels - 1) << 4 | 8]) + _utf8(number)
    frame += struct.pack(">H", block - 1)
    frame += bytes([_crc(frame, 8, 0x07)])
    # For each channel a subframe of the kind CONSTANT, without wasted bits, of the value 0.
    frame += bytes(3) * channels
    return frame + struct.pack(">H", _crc(frame, 16, 0x8005))


def _utf8(number):
    # Surrogates are numbers as all others here.
    return chr(number).encode("utf-8", "surrogatepass")


@functools.cache
def _crc_table(bits, polynomial):
    table = []
    for byte in range(256):
        crc = byte << (bits - 8)
        for _ in range(8):
            crc = crc << 1 ^ (polynomial if crc >> (bits - 1) & 1 else 0)
        table.append(crc & (1 << bits) - 1)
    return table


def _crc(data, bits, polynomial):
    table, mask, crc = _crc_table(bits, polynomial), (1 << bits) - 1, 0
    for byte in data:
        crc = (crc << 8 & mask) ^ table[crc >> (bits - 8) ^ byte]
    return crc
