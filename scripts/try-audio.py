#!/usr/bin/env python3
"""Makes a file of every container and codec, and prints what the program says about each: the rows
of the table in docs/audio.md. Needs ffmpeg (FFMPEG) and a built bailando.

usage: scripts/try-audio.py [BAILANDO [SONG [FOLDER]]]

FOLDER keeps the files.
"""

import os
import pathlib
import struct
import subprocess
import sys
import tempfile

FFMPEG = [os.environ.get("FFMPEG", "ffmpeg"), "-hide_banner", "-loglevel", "error", "-y"]
SECONDS = 3
ROWS = "rows.npy"

# By the file's ending, what follows -c:a: a codec and perhaps options, ~ in place of spaces.
ENCODED = {
    "wav": "pcm_u8 pcm_s16le pcm_s24le pcm_s32le pcm_f32le pcm_f64le pcm_alaw pcm_mulaw adpcm_ms "
    "adpcm_ima_wav libmp3lame pcm_s24le~-ac~6 adpcm_yamaha g722~-ar~16000~-ac~1 "
    "libgsm_ms~-ar~8000~-ac~1 ac3 wmav2 aac pcm_s16le~-rf64~always",
    "w64": "pcm_s16le",
    "aiff": "pcm_s8 pcm_s16be pcm_s24be pcm_s32be pcm_s16le pcm_f32be pcm_f64be pcm_alaw pcm_mulaw "
    "adpcm_ima_qt",
    "caf": "pcm_s16be alac libopus",
    "au": "pcm_s16be pcm_mulaw",
    "flac": "flac flac~-sample_fmt~s32 flac~-ac~8~-ar~192000",
    "mp3": "libmp3lame libmp3lame~-ar~22050 libmp3lame~-ar~11025 libmp3lame~-q:a~4",
    "mp2": "mp2",
    "ogg": "libvorbis libopus libopus~-ac~6 flac libspeex~-ar~16000~-ac~1",
    "webm": "libvorbis libopus libopus~-ac~6",
    "mka": "libvorbis libopus aac aac~-ac~6 libmp3lame flac pcm_s16le pcm_s16be pcm_f32le alac ac3 "
    "eac3 mp2 dca~-strict~-2 wavpack tta truehd~-strict~-2 wmav2",
    "m4a": "aac aac~-ac~6 alac ac3 eac3~-f~mp4 libopus~-f~mp4 flac~-f~mp4~-strict~-2 "
    "libmp3lame~-f~mp4 mp2~-f~mp4 libvorbis~-f~mp4 libopus~-ac~6~-f~mp4 "
    "dca~-strict~-2~-f~mp4",
    "mov": "aac pcm_s16le pcm_s16be pcm_s24le pcm_f32le alac pcm_mulaw pcm_alaw adpcm_ima_qt",
    "3gp": "aac",
    "aac": "aac",
    "latm": "aac",
    "wma": "wmav2",
    "wv": "wavpack",
    "tta": "tta",
    "ac3": "ac3",
    "dts": "dca~-strict~-2",
    "spx": "libspeex~-ar~16000~-ac~1",
    "rm": "real_144~-ar~8000~-ac~1",
    "voc": "pcm_u8",
}
# Inputs beside the song, and what follows: films, and films without sound.
FILMS = {
    "film.mp4": "-c:v mpeg4 -c:a aac",
    "film.mkv": "-c:v mpeg4 -c:a aac",
    "film.webm": "-c:v libvpx -c:a libopus",
    "film.ogv": "-c:v libtheora -c:a libvorbis",
    "film.mov": "-c:v mpeg4 -c:a aac",
    "fragments.mp4": "-c:v mpeg4 -c:a aac -movflags frag_keyframe+empty_moov",
    "film.avi": "-c:v mpeg4 -c:a libmp3lame",
    "film.flv": "-c:v flv1 -c:a aac",
    "film.ts": "-c:v mpeg2video -c:a mp2",
    "film.mpg": "-c:v mpeg2video -c:a mp2",
    "film.wmv": "-c:v wmv2 -c:a wmav2",
    "silent-film.mp4": "-c:v mpeg4 -an",
    "silent-film.mkv": "-c:v mpeg4 -an",
    "silent-film.webm": "-c:v libvpx -an",
    "silent-film.ogv": "-c:v libtheora -an",
}
# Kinds that ffmpeg cannot write, by their first bytes.
HEADS = {
    "song.mid": b"MThd\0\0\0\6\0\0\0\1\0\x60MTrk\0\0\0\4\0\xff\x2f\0",
    "speech.amr": b"#!AMR\n" + b"\x3c" + bytes(31),
    "song.ape": b"MAC \x96\x0f\0\0",
    "song.mpc": b"MPCKSH\x10\0",
    "song.dsf": b"DSD \x1c\0\0\0\0\0\0\0",
    "layer-1.mp1": b"\xff\xff\x50\xc0" + bytes(60),
    "archive.zip": b"PK\3\4\x14\0",
    "archive.gz": b"\x1f\x8b\x08\0",
    "picture.png": b"\x89PNG\r\n\x1a\n",
    "picture.jpg": b"\xff\xd8\xff\xe0",
    "picture.gif": b"GIF89a",
    "archive.bz2": b"BZh9",
    "archive.xz": b"\xfd7zXZ\0",
    "archive.7z": b"7z\xbc\xaf\x27\x1c",
    "archive.rar": b"Rar!\x1a",
    "archive.zst": b"\x28\xb5\x2f\xfd",
    "song.8svx": b"FORM\0\0\0\x088SVX",
    "rows-of-numbers.npy": b"\x93NUMPY\1\0",
    "tag-alone.mp3": b"ID3\4\0\0\0\0\0\2xx",
    "paper.pdf": b"%PDF-1.7\n",
    "page.html": b"<!doctype html><title>Song</title>",
    "notes.txt": b"a song about a rose\n",
    "data.json": b'{"song": 1}',
    "program": b"\x7fELF\2\1\1",
    "nothing": b"",
}


def ffmpeg(arguments):
    done = subprocess.run([*FFMPEG, *arguments], capture_output=True, text=True)
    if done.returncode:
        print("ffmpeg:", " ".join(map(str, arguments)), done.stderr.strip()[-200:], file=sys.stderr)


def free_format(mp3):
    """Takes the bit rate out of every frame's header; frames of 48 kHz have no padding."""
    data = bytearray(mp3.read_bytes())
    length = 144 * 128_000 // 48_000
    for at in range(0, len(data), length):
        data[at + 2] &= 0x0F
    return bytes(data)


def of_configuration(m4a, configuration):
    """Puts another AudioSpecificConfig (ISO 14496-3 section 1.6) in the place of AAC-LC's."""
    data = m4a.read_bytes()
    at = data.index(b"esds")
    at = data.index(b"\x05\x80\x80\x80", at) + 5
    return data[:at] + configuration + data[at + len(configuration) :]


def big_endian(wav):
    data = wav.read_bytes()
    fields = struct.unpack("<IHHIIHH", data[16:36])
    samples = bytearray(data[data.index(b"data") + 8 :])
    samples[0::2], samples[1::2] = samples[1::2], samples[0::2]
    chunks = b"WAVEfmt " + struct.pack(">IHHIIHH", *fields)
    chunks += b"data" + struct.pack(">I", len(samples)) + samples
    return b"RIFX" + struct.pack(">I", len(chunks)) + chunks


def make(song, folder):
    """Writes all files."""
    source = ["-t", str(SECONDS), "-i", song, "-ac", "2", "-ar", "48000"]
    for ending, codecs in ENCODED.items():
        for codec in codecs.split():
            name = codec.replace("~-strict~-2", "").replace("~-", "-").replace("~", "=")
            output = folder / f"{ending}-{name.replace(':', '')}.{ending}"
            ffmpeg([*source, "-vn", "-c:a", *codec.split("~"), output])
    for name, options in FILMS.items():
        picture = ["-f", "lavfi", "-i", f"testsrc=s=176x144:r=25:d={SECONDS}"]
        ffmpeg([*picture, *source, *options.split(), folder / name])
    ffmpeg([*source, "-f", "s16le", folder / "samples.pcm"])
    for name, head in HEADS.items():
        (folder / name).write_bytes(head)

    constant = folder / "constant.mp3"
    options = ["-ar", "48000", "-b:a", "128k", "-write_xing", "0", "-id3v2_version", "0"]
    ffmpeg([*source, "-c:a", "libmp3lame", *options, constant])
    (folder / "free-format.mp3").write_bytes(free_format(constant))
    plain = folder / "wav-pcm_s16le.wav"
    (folder / "rifx.wav").write_bytes(big_endian(plain))
    rf64 = (folder / "wav-pcm_s16le-rf64=always.wav").read_bytes()
    (folder / "bw64.wav").write_bytes(rf64.replace(b"RF64", b"BW64", 1))
    m4a = folder / "m4a-aac.m4a"
    # 48 kHz and spectral band replication; with parametric stereo; Main; scalable sample rate.
    (folder / "he-aac.m4a").write_bytes(of_configuration(m4a, b"\x29\x90\x08\x00"))
    (folder / "he-aac-v2.m4a").write_bytes(of_configuration(m4a, b"\xe9\x90\x08\x00"))
    (folder / "aac-main.m4a").write_bytes(of_configuration(m4a, b"\x09\x90"))
    (folder / "aac-ssr.m4a").write_bytes(of_configuration(m4a, b"\x19\x90"))


def outcome(bailando, file):
    """Whether a file is read, and every word about it."""
    command = [bailando, "features", "--quiet", file, "-o", file.parent / ROWS]
    done = subprocess.run(command, capture_output=True, text=True)
    return "refused" if done.returncode else "danced", done.stderr.replace(f"{file}: ", "").strip()


def main():
    bailando = sys.argv[1] if len(sys.argv) > 1 else "target/release/bailando"
    song = sys.argv[2] if len(sys.argv) > 2 else "tests/fixtures/audio/demo.flac"
    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(sys.argv[3] if len(sys.argv) > 3 else scratch)
        folder.mkdir(exist_ok=True)
        make(song, folder)
        for file in sorted(folder.iterdir()):
            if file.name != ROWS:
                print(file.name, *outcome(bailando, file), sep=" | ")


if __name__ == "__main__":
    main()
