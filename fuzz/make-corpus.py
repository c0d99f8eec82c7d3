#!/usr/bin/env python3
"""Writes the seeds of the fuzz targets into fuzz/corpus/.

Needs nothing but Python's standard library. Songs are cut from tests/fixtures/audio, everything
else is made here. The test of the corpus holds files to their names: `good-` ones are accepted,
`bad-` ones are refused. Inputs that once broke something are added by hand as `found-..` and are
left alone.
"""

import io
import json
import pickle
import struct
import sys
import types
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
AUDIO = ROOT / "tests/fixtures/audio"


def write(target, name, content):
    path = HERE / "corpus" / target / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


# --- container -----------------------------------------------------------------------------------


def wav(channels, rate, bits, data, kind=1, declared=None, before=b""):
    width = channels * bits // 8
    form = struct.pack("<HHIIHH", kind, channels, rate, rate * width, width, bits)
    if kind == 0xFFFE:  # extensible: the codec is a GUID
        guid = struct.pack("<H", 1) + bytes.fromhex("000000001000800000aa00389b71")
        form += struct.pack("<HHI", 22, bits, (1 << channels) - 1) + guid
    body = before + b"fmt " + struct.pack("<I", len(form)) + form
    sizes = (12 + len(body) + len(data), len(data)) if declared is None else (declared, declared)
    body += b"data" + struct.pack("<I", sizes[1]) + data
    return b"RIFF" + struct.pack("<I", sizes[0]) + b"WAVE" + body


def ramp(count, width):
    """Samples of a rough saw tooth, little-endian."""
    values = ((i * 977) % (1 << (8 * width)) for i in range(count))
    return b"".join(value.to_bytes(width, "little") for value in values)


def crc(data, bits, polynomial):
    value = 0
    for byte in data:
        value ^= byte << (bits - 8)
        for _ in range(8):
            carry = value >> (bits - 1)
            value = (value << 1) & ((1 << bits) - 1)
            value ^= polynomial if carry else 0
    return value


def flac_info(rate, channels, bits, block, frames):
    packed = rate << 44 | (channels - 1) << 41 | (bits - 1) << 36 | frames
    return struct.pack(">HH", block, block) + bytes(6) + packed.to_bytes(8, "big") + bytes(16)


def flac(info, frames):
    return b"fLaC" + struct.pack(">I", 0x80000000 | len(info)) + info + frames


def constant_flac(frames, declared):
    """Mono, 8 kHz, 16 bits: blocks of 4096 equal samples."""
    stream = b""
    for number in range(frames):
        head = bytes([0xFF, 0xF8, 0xC4, 0x08, number])
        head += bytes([crc(head, 8, 0x07)])
        body = head + bytes([0x00]) + struct.pack(">h", 100 * number)
        stream += body + struct.pack(">H", crc(body, 16, 0x8005))
    return flac(flac_info(8000, 1, 16, 4096, declared), stream)


def flac_fixture():
    """The first frame of the demo song: linear prediction and Rice codes."""
    song = (AUDIO / "demo.flac").read_bytes()
    at = 4
    while True:
        last, size = song[at] >> 7, int.from_bytes(song[at + 1 : at + 4], "big")
        at += 4 + size
        if last:
            break
    end = song.index(song[at : at + 4] + b"\x01", at)
    info = song[8:21] + bytes([song[21] & 0xF0]) + bytes(20)  # no length, no checksum
    return flac(info, song[at:end])


def ogg_page(packets, flags, head=bytes(20)):
    """A page; `head` has the place, the stream, the number and room for the checksum."""
    lacing = b"".join(b"\xff" * (len(p) // 255) + bytes([len(p) % 255]) for p in packets)
    page = b"OggS" + bytes([0, flags]) + head + bytes([len(lacing)]) + lacing + b"".join(packets)
    page = page[:22] + bytes(4) + page[26:]
    return page[:22] + struct.pack("<I", crc(page, 32, 0x04C11DB7)) + page[26:]


def ogg_fixture(packets):
    """The headers of the demo song and its first packets."""
    song = (AUDIO / "demo.ogg").read_bytes()
    at = 0
    for _ in range(2):
        segments = song[at + 26]
        at += 27 + segments + sum(song[at + 27 : at + 27 + segments])
    front, page = song[:at], song[at:]
    inner, taken, packet = 27 + page[26], [], 0
    for size in page[27:inner]:
        packet += size
        if size < 255:
            taken.append(page[inner : inner + packet])
            inner, packet = inner + packet, 0
    return front + ogg_page(taken[:packets], 0, page[6:26])


def atom(kind, content):
    return struct.pack(">I", 8 + len(content)) + kind + content


def atoms(content):
    at = 0
    while at + 8 <= len(content):
        size, kind = struct.unpack(">I4s", content[at : at + 8])
        yield kind, content[at + 8 : at + size]
        at += size


def m4a_fixture(samples):
    """The first samples of the demo song, with tables to match."""
    song = (AUDIO / "demo.m4a").read_bytes()
    top = dict(atoms(song))
    start = song.index(b"mdat") + 4
    sizes = top[b"moov"].index(b"stsz") + 16
    sizes = struct.unpack(f">{samples}I", top[b"moov"][sizes : sizes + 4 * samples])
    data = song[start : start + sum(sizes)]
    front = atom(b"ftyp", top[b"ftyp"])
    tables = {
        b"stts": struct.pack(">IIII", 0, 1, samples, 1024),
        b"stsc": struct.pack(">IIIII", 0, 1, 1, samples, 1),
        b"stsz": struct.pack(">III", 0, 0, samples) + struct.pack(f">{samples}I", *sizes),
        b"stco": struct.pack(">III", 0, 1, len(front) + 8),
    }
    nests = (b"trak", b"mdia", b"minf", b"stbl")

    def rewritten(content):
        parts = []
        for kind, inner in atoms(content):
            if kind in (b"sgpd", b"sbgp"):
                continue
            inner = tables.get(kind, rewritten(inner) if kind in nests else inner)
            parts.append(atom(kind, inner))
        return b"".join(parts)

    return front + atom(b"mdat", data) + atom(b"moov", rewritten(top[b"moov"]))


def containers():
    good = {
        "wav-16": wav(1, 8000, 16, ramp(800, 2)),
        "wav-24-stereo": wav(2, 44100, 24, ramp(1800, 3)),
        "wav-8": wav(1, 8000, 8, ramp(400, 1)),
        "wav-float": wav(1, 48000, 32, struct.pack("<f", 0.25) * 700, kind=3),
        "wav-extensible": wav(6, 8000, 16, ramp(1200, 2), kind=0xFFFE),
        "wav-from-a-pipe": wav(1, 8000, 16, ramp(400, 2), declared=0xFFFFFFFF),
        "wav-with-a-list": wav(1, 8000, 16, ramp(400, 2), before=b"LIST\x04\0\0\0INFO"),
        "flac-constant": constant_flac(4, 4 * 4096),
        "flac-of-no-length": constant_flac(2, 0),
        "flac-song": flac_fixture(),
        "ogg-song": ogg_fixture(12),
        "m4a-song": m4a_fixture(6),
        "ogg-opus-song": (AUDIO / "cases/speech_60ms.opus").read_bytes(),
        "webm-opus": (AUDIO / "cases/opus.webm").read_bytes(),
        "m4a-of-fragments": (AUDIO / "cases/fragments.mp4").read_bytes(),
        "wav-of-no-size": wav(1, 8000, 16, ramp(800, 2), declared=0),
    }
    mp3 = (AUDIO / "demo.mp3").read_bytes()
    frames = mp3[mp3.index(b"\xff\xfb") :]
    good["mp3-song"] = frames[: 6 * 418]
    tag = b"ID3\x04\0\0\0\0\0\x0aTIT2\0\0\0\0\0\0"
    good["mp3-with-tags"] = tag + frames[: 4 * 418] + b"TAG" + bytes(125)
    bad = {
        "flac-of-hours": constant_flac(2, 1 << 35),
        "wav-of-no-rate": wav(1, 0, 16, ramp(40, 2)),
        "wav-of-200-channels": wav(200, 8000, 16, ramp(400, 2)),
        "wav-adpcm": wav(1, 8000, 4, ramp(400, 1), kind=2),
        "ogg-opus": ogg_page([b"OpusHead\x01\x02\x38\x01\x80\xbb\0\0\0\0\0"], 2),
        "m4a-of-tables-alone": atom(b"ftyp", b"M4A \0\0\0\0") + atom(b"moov", b""),
        "mp3-tag-alone": tag,
        "riff-avi": b"RIFF\x10\0\0\0AVI " + bytes(16),
        "png": b"\x89PNG\r\n\x1a\n" + bytes(16),
        "zip": b"PK\x03\x04" + bytes(26),
        "text": b"la la la\n",
        "nothing": b"",
    }
    for kind, files in (("good", good), ("bad", bad)):
        for name, content in files.items():
            write("container", f"{kind}-{name}", content)


# --- options -------------------------------------------------------------------------------------


def options():
    tail = "continue_from=AgEjRWcAAABAPwAAAAAAAAAAAAEAAgA"
    good = {
        "none": "",
        "numbers": "fps=24&seed=9007199254740991&temperature=0.5&top_k=7&guidance=2.5&candidates=3",
        "start": "start_upper=1&start_lower=2&window=sliding&hop=15",
        "part": "offset_s=1.5&duration_s=2e1&root_motion=false&music=true",
        "glb": "format=glb",
        "written": "format=bvh&include=rotations&encoding=base64&bvh_unit=m",
        "tail": tail,
        "escaped": "format=%6as%6Fn&fps=%360",
        "hop": "window=hop&hop=1&candidates=1&guidance=1",
    }
    bad = {
        "tail-and-start": tail + "&start_upper=1",
        "tail-of-nothing": "continue_from=AgEjRWcAAABAPwAAAAAAAAAAAA",
        "tail-cut": tail[:-1],
        "tail-padded": tail + "=",
        "code": "start_upper=65535",
        "twice": "seed=1&seed=1",
        "unknown": "sede=1",
        "negative": "seed=-1",
        "nan": "temperature=NaN",
        "infinite": "duration_s=1e999",
        "long": "seed=" + "1" * 600,
        "not-utf-8": "fps=%ff%fe",
        "semicolon": "fps=30;seed=1",
    }
    for kind, files in (("good", good), ("bad", bad)):
        for name, content in files.items():
            write("options", f"{kind}-{name}", content)


# --- manifest ------------------------------------------------------------------------------------


def manifests():
    model = json.loads((ROOT / "models/default/manifest.json").read_text())
    first = json.loads((ROOT / "tests/fixtures/model/manifest_of_the_first_model.json").read_text())
    for manifest in (model, first):
        manifest["training"] = {}
        manifest["start_codes"] = manifest["start_codes"][:2]

    def put(name, manifest, **changes):
        changed = json.loads(json.dumps(manifest))
        for path, value in changes.items():
            *parents, last = path.split("__")
            inner = changed
            for parent in parents:
                inner = inner[parent]
            inner[last] = value
        write("manifest", name, json.dumps(changed, separators=(",", ":")))

    put("good-default", model)
    put("good-first", first)
    put("good-bare", model, start_codes=[], training={"steps": [1, 2.5, None]})
    entry = {"bytes": 1, "sha256": "0" * 64}
    for name, path in (("parent", "../x"), ("absolute", "/etc/passwd"), ("folder", "a/b")):
        put(f"bad-file-{name}", model, files={**model["files"], path: entry})
    put("bad-layers", model, gpt__layers=1 << 60)
    put("bad-memory", model, gpt__layers=256, gpt__block=4096, gpt__channels=16384)
    put("bad-vocabulary", model, vocabulary__upper=1 << 40)
    put("bad-receptive", model, decoder__receptive_codes=1 << 60)
    put("bad-parents", model, skeleton__parents=[-1] * 24)
    put("bad-guidance", model, sampling__guidance=1e30)
    put("bad-version", model, format_version=2)
    write("manifest", "bad-nested", "[" * 2000)
    write("manifest", "bad-array", "[]")


# --- checkpoint ----------------------------------------------------------------------------------


class Storage:
    """Values outside the pickle."""

    def __init__(self, key, kind, values, data):
        self.key, self.kind, self.values, self.data = key, kind, values, data


class Tensor:
    def __init__(self, storage, shape, offset=0, strides=None):
        self.storage, self.shape, self.offset = storage, tuple(shape), offset
        if strides is None:
            strides, step = [], 1
            for size in reversed(shape):
                strides.insert(0, step)
                step *= size
        self.strides = tuple(strides)

    def __reduce__(self):
        return REBUILD, (self.storage, self.offset, self.shape, self.strides, False, ())


class Call:
    """What a hostile file asks for: a function and its arguments."""

    def __init__(self, function, arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


def module(name, **members):
    """A module that the pickler finds; nothing of it is ever called."""
    made = sys.modules.setdefault(name, types.ModuleType(name))
    for key, value in members.items():
        value.__module__, value.__qualname__ = name, key
        setattr(made, key, value)


def rebuild():
    raise NotImplementedError


REBUILD = rebuild
KINDS = {name: type(name, (), {}) for name in ("FloatStorage", "HalfStorage", "LongStorage")}
module("torch", **KINDS)
module("torch._utils", _rebuild_tensor_v2=REBUILD)


class Pickler(pickle.Pickler):
    def __init__(self, out):
        super().__init__(out, protocol=2)
        self.storages = {}

    def persistent_id(self, value):
        if not isinstance(value, Storage):
            return None
        self.storages[value.key] = value
        return ("storage", KINDS[value.kind], value.key, "cpu", value.values)


def pickled(value):
    out = io.BytesIO()
    pickler = Pickler(out)
    pickler.dump(value)
    return out.getvalue(), pickler.storages


def zipped(state):
    content, storages = pickled(state)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as archive:

        def add(name, data):
            archive.writestr(zipfile.ZipInfo("a/" + name), data)

        add("data.pkl", content)
        add("byteorder", b"little")
        for key, storage in storages.items():
            add("data/" + key, storage.data)
    return out.getvalue()


def legacy(state):
    content, storages = pickled(state)
    magic = pickle.dumps(0x1950A86A20F9469CFC6C, 2)
    system = {"protocol_version": 1001, "little_endian": True, "type_sizes": {"int": 4}}
    front = magic + pickle.dumps(1001, 2) + pickle.dumps(system, 2) + content
    front += pickle.dumps(sorted(storages), 2)
    for key in sorted(storages):
        front += struct.pack("<q", storages[key].values) + storages[key].data
    return front


class Shapes:
    """Tensors of counting values; all share one storage, as flattened parameters do."""

    def __init__(self, shapes):
        sizes = [size_of(shape) for shape in shapes.values()]
        values = [((i * 37) % 101 - 50) / 64 for i in range(sum(sizes))]
        data = struct.pack(f"<{len(values)}f", *values)
        storage = Storage("0", "FloatStorage", len(values), data)
        self.state, offset = {}, 0
        for (name, shape), size in zip(shapes.items(), sizes):
            self.state[name] = Tensor(storage, shape, offset)
            offset += size


def size_of(shape):
    size = 1
    for dimension in shape:
        size *= dimension
    return size


def convolution(name, outputs, inputs, kernel):
    return {f"{name}.weight": (outputs, inputs, kernel), f"{name}.bias": (outputs,)}


def stack(name, width):
    block = f"{name}.model.0.model"
    return {**convolution(f"{block}.1", width, width, 3), **convolution(f"{block}.3", width, width, 1)}


def vqvae():
    """The smallest pose VQ-VAE: one halving, one channel."""
    shapes = {}

    def decoder(name, columns):
        model = f"{name}.level_blocks.0.model"
        shapes.update(convolution(f"{model}.0", 1, 1, 3))
        shapes.update(stack(f"{model}.1.0", 1))
        shapes.update({f"{model}.1.1.weight": (1, 1, 4), f"{model}.1.1.bias": (1,)})
        shapes.update(convolution(f"{name}.out", columns, 1, 3))

    for half, columns in (("vqvae_up", 45), ("vqvae_down", 27)):
        shapes[f"{half}.bottleneck.level_blocks.0.k"] = (2, 1)
        encoder = f"{half}.encoders.0.level_blocks.0.model"
        shapes.update(convolution(f"{encoder}.0.0", 1, columns, 4))
        shapes.update(stack(f"{encoder}.0.1", 1))
        shapes.update(convolution(f"{encoder}.1", 1, 1, 3))
        decoder(f"{half}.decoders.0", columns)
    decoder("vqvae_down.decoders_root.0", 3)
    return shapes


def gpt():
    """The smallest motion GPT: two channels, a block in each half."""

    def linear(name, outputs, inputs):
        return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}

    def norm(name):
        return {f"{name}.weight": (2,), f"{name}.bias": (2,)}

    shapes = {
        "gpt_base.tok_emb_up.weight": (2, 2),
        "gpt_base.tok_emb_down.weight": (2, 2),
        "gpt_base.pos_emb": (1, 6, 2),
        **linear("gpt_base.cond_emb", 2, 3),
        **norm("gpt_head.ln_f"),
        "gpt_head.head_up.weight": (2, 2),
        "gpt_head.head_down.weight": (2, 2),
    }
    for part in ("gpt_base", "gpt_head"):
        block = f"{part}.blocks.0"
        shapes.update({**norm(f"{block}.ln1"), **norm(f"{block}.ln2")})
        for name in ("query", "key", "value", "proj"):
            shapes.update(linear(f"{block}.attn.{name}", 2, 2))
        shapes.update({**linear(f"{block}.mlp.0", 2, 2), **linear(f"{block}.mlp.2", 2, 2)})
    return shapes


def safetensors(tensors):
    header, data = {}, b""
    for name, (dtype, shape, values) in tensors.items():
        place = [len(data), len(data) + len(values)]
        header[name] = {"dtype": dtype, "shape": shape, "data_offsets": place}
        data += values
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data


def checkpoints():
    floats, halves = struct.pack("<4f", 1, 2, 3, 4), struct.pack("<2e", 1, 2)
    small = {"_orig_mod.a": ("F32", [2, 2], floats), "b": ("F16", [2], halves)}
    small["c"] = ("BF16", [], b"\0\0")
    write("checkpoint", "good-small-safetensors", safetensors(small))
    for name, tensor in (
        ("integers", ("I64", [2], floats)),
        ("outside", ("F32", [5], floats)),
        ("huge", ("F32", [1 << 60], floats)),
    ):
        write("checkpoint", f"bad-{name}-safetensors", safetensors({"a": tensor}))
    for name, shapes in (("vqvae", vqvae()), ("gpt", gpt())):
        state = Shapes(shapes).state
        write("checkpoint", f"good-{name}-zip", zipped({"model": state}))
        prefixed = {f"module.{key}": value for key, value in state.items()}
        write("checkpoint", f"good-{name}-legacy", legacy({"model": prefixed, "epoch": 1}))

    four = Storage("0", "FloatStorage", 4, struct.pack("<4f", 1, 2, 3, 4))
    halves = Storage("1", "HalfStorage", 4, struct.pack("<4e", 1, 2, 3, 4))
    numbers = Storage("2", "LongStorage", 2, struct.pack("<2q", 1, 2))
    transposed = Tensor(four, (2, 2), strides=(1, 2))
    both = (("zip", zipped), ("legacy", legacy))
    for kind, container in both:
        small = {"a": transposed, "b": Tensor(halves, (4,)), "c": Tensor(four, (), 3)}
        write("checkpoint", f"good-small-{kind}", container(small))
        # What must not run: os.system is `posix.system` to a pickle.
        attack = {"a": Tensor(four, (4,)), "b": Call(getattr(sys.modules["os"], "system"), ("true",))}
        write("checkpoint", f"good-call-{kind}", container(attack))
        write("checkpoint", f"bad-call-alone-{kind}", container(attack["b"]))
        write("checkpoint", f"bad-integers-{kind}", container({"a": Tensor(numbers, (2,))}))
        outside = {"a": Tensor(four, (5,)), "b": Tensor(four, (1 << 40,), strides=(0,))}
        write("checkpoint", f"bad-outside-{kind}", container(outside))
        huge = Storage("3", "FloatStorage", 1 << 60, b"\0" * 4)
        write("checkpoint", f"bad-huge-{kind}", container({"a": Tensor(huge, (1 << 60,))}))
        shared = Storage("4", "FloatStorage", 512, bytes(2048))
        many = {f"w{i}": Tensor(shared, (512,)) for i in range(40)}
        write("checkpoint", f"bad-amplified-{kind}", container(many))
        empty = Tensor(four, (0, 1 << 40, 1 << 40), 1 << 61, (1, 1 << 40, 1))
        write("checkpoint", f"good-empty-{kind}", container({"a": empty}))


# --- graph ---------------------------------------------------------------------------------------


def varint(value):
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes(out) + bytes([value])


def field(number, value):
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    return varint(number << 3 | 2) + varint(len(value)) + value


def graphs():
    inside = field(1, 2) + field(2, 1) + field(8, b"w") + field(9, struct.pack("<2f", 1, 2))
    entry = field(1, b"location") + field(2, b"../../etc/passwd")
    outside = field(1, 2) + field(2, 1) + field(8, b"w") + field(13, entry) + field(14, 1)
    add = field(1, b"x") + field(1, b"w") + field(2, b"y") + field(4, b"Add")

    def attribute(number, content):
        return field(5, field(1, b"value") + field(number, content) + field(20, 4))

    def model(graph):
        opset = field(8, field(1, b"") + field(2, 20))
        return field(1, 9) + field(7, field(1, add) + field(2, b"g") + graph) + opset

    places = {
        "initializer": lambda tensor: model(field(5, tensor)),
        "sparse": lambda tensor: model(field(15, field(1, tensor))),
        "constant": lambda tensor: model(field(1, field(4, b"Constant") + attribute(5, tensor))),
        "constants": lambda tensor: model(field(1, field(4, b"Constant") + attribute(10, tensor))),
    }
    # Graphs inside of graphs are refused, wherever their values lie.
    nested = {
        "branch": lambda tensor: model(
            field(1, field(4, b"If") + attribute(6, field(5, tensor)))
        ),
        "function": lambda tensor: model(b"")
        + field(25, field(7, field(4, b"Constant") + attribute(5, tensor))),
        "training": lambda tensor: model(b"") + field(20, field(1, field(5, tensor))),
    }
    for name, place in places.items():
        write("graph", f"good-{name}", place(inside))
        write("graph", f"bad-{name}", place(outside))
    for name, place in nested.items():
        write("graph", f"bad-{name}", place(outside))
        write("graph", f"bad-{name}-inside", place(inside))
    write("graph", "bad-cut-off", places["initializer"](inside)[:-20])
    write("graph", "bad-longer-than-the-file", field(1, 9) + varint(7 << 3 | 2) + varint(1 << 60))
    write("graph", "bad-group", varint(7 << 3 | 3) + varint(7 << 3 | 4))
    write("graph", "bad-long-tag", places["initializer"](inside) + varint(13 << 3 | 1 << 40) + b"\0")


# --- rig -----------------------------------------------------------------------------------------

# Joints of a person of 1 m: name, parent, place.
PERSON = [
    ("Hips", None, (0, 0.53, 0)),
    ("Spine", 0, (0, 0.6, 0)),
    ("Chest", 1, (0, 0.74, 0)),
    ("Neck", 2, (0, 0.84, 0)),
    ("Head", 3, (0, 0.9, 0)),
]
for side, sign in (("Left", 1), ("Right", -1)):
    chest = 2
    first = len(PERSON)
    PERSON += [
        (f"{side}Arm", chest, (sign * 0.1, 0.81, 0)),
        (f"{side}ForeArm", first, (sign * 0.27, 0.81, 0)),
        (f"{side}Hand", first + 1, (sign * 0.42, 0.81, 0)),
        (f"{side}UpLeg", 0, (sign * 0.05, 0.5, 0)),
        (f"{side}Leg", first + 3, (sign * 0.05, 0.28, 0.005)),
        (f"{side}Foot", first + 4, (sign * 0.05, 0.05, -0.01)),
        (f"{side}ToeBase", first + 5, (sign * 0.06, 0.012, 0.07)),
    ]


def from_parent(index):
    _, parent, place = PERSON[index]
    above = (0, 0, 0) if parent is None else PERSON[parent][2]
    return [round(a - b, 6) for a, b in zip(place, above)]


def below(index):
    return [child for child, (_, parent, _) in enumerate(PERSON) if parent == index]


def bvh(names=lambda name: name, scale=100, channels="3"):
    def joint(index, depth):
        kind = "ROOT" if depth == 0 else "JOINT"
        place = " ".join(str(scale * value) for value in from_parent(index))
        places = "6 Xposition Yposition Zposition" if depth == 0 else channels
        inside = "".join(joint(child, depth + 1) for child in below(index))
        if not inside:
            inside = "End Site\n{\nOFFSET 0 0 4\n}\n"
        channel = f"CHANNELS {places} Zrotation Xrotation Yrotation"
        return f"{kind} {names(PERSON[index][0])}\n{{\nOFFSET {place}\n{channel}\n{inside}}}\n"

    return "HIERARCHY\n" + joint(0, 0) + "MOTION\nFrames: 0\nFrame Time: 0.03\n"


def glb(names=lambda name: name, binary=None, change=lambda document: None):
    nodes = [
        {"name": names(name), "translation": from_parent(index), "children": below(index)}
        for index, (name, _, _) in enumerate(PERSON)
    ]
    for node in nodes:
        if not node["children"]:
            del node["children"]
    document = {"asset": {"version": "2.0"}, "nodes": nodes}
    if binary is not None:
        document["buffers"] = [{"byteLength": len(binary)}]
        document["bufferViews"] = [{"buffer": 0, "byteLength": len(binary)}]
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text
    if binary is not None:
        binary += bytes(-len(binary) % 4)
        chunks += struct.pack("<I", len(binary)) + b"BIN\0" + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def rigs():
    def changed(**members):
        return glb(change=lambda document: document.update(members))

    def node(index, **members):
        return glb(change=lambda document: document["nodes"][index].update(members))

    numbers = iter(range(1000))
    human = {"hips": 0, "head": 4}
    for side, first in (("left", 5), ("right", 12)):
        for at, part in enumerate(
            ("UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toes")
        ):
            human[side + part] = first + at
    vrm1 = {"VRMC_vrm": {"humanoid": {"humanBones": {k: {"node": v} for k, v in human.items()}}}}
    bones = [{"bone": name, "node": index} for name, index in human.items()]
    vrm0 = {"VRM": {"humanoid": {"humanBones": bones + [{"bone": "jaw", "node": -1}]}}}

    write("rig", "good-bvh", bvh())
    write("rig", "good-bvh-metres-crlf", bvh(scale=1).replace("\n", "\r\n"))
    write("rig", "good-bvh-six-channels", bvh(channels="6 Xposition Yposition Zposition"))
    write("rig", "good-bvh-shape", bvh(names=lambda _: f"b{next(numbers)}"))
    write("rig", "good-glb", glb())
    write("rig", "good-glb-binary", glb(binary=bytes(range(40))))
    write("rig", "good-glb-shape", glb(names=lambda _: f"b{next(numbers)}"))
    write("rig", "good-vrm0", changed(extensions=vrm0))
    write("rig", "good-vrm1", changed(extensions=vrm1))
    write("rig", "good-glb-matrix", glb(change=as_matrix))
    write("rig", "bad-nothing", "")
    write("rig", "bad-bvh-nan", bvh().replace("OFFSET 0.0", "OFFSET nan", 1))
    write("rig", "bad-bvh-no-end", bvh().split("MOTION")[0])
    write("rig", "bad-bvh-still", bvh().replace("6 Xposition Yposition Zposition", "3"))
    write("rig", "bad-bvh-flat", bvh(scale=0))
    write("rig", "bad-bvh-deep", "HIERARCHY\n" + "ROOT a\n{\n" + "JOINT a\n{\n" * 2100)
    write("rig", "bad-glb-cycle", node(4, children=[0]))
    write("rig", "bad-glb-two-parents", node(4, children=[7]))
    write("rig", "bad-glb-no-node", node(4, children=[99]))
    write("rig", "bad-glb-zero-turn", node(2, rotation=[0, 0, 0, 0]))
    write("rig", "bad-glb-huge", node(2, translation=[1e308, 1e308, 1e308]))
    write("rig", "bad-glb-uneven", node(0, scale=[1, 2, 1]))
    write("rig", "bad-glb-long", glb()[:-4])
    write("rig", "bad-glb-no-buffer", glb(binary=b"1234").replace(b"byteLength", b"byteLongth"))
    write("rig", "bad-vrm-node", changed(extensions={"VRMC_vrm": {"humanoid": {"humanBones": {"hips": {"node": 99}}}}}))


def as_matrix(document):
    for node in document["nodes"]:
        x, y, z = node.pop("translation")
        node["matrix"] = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1]


def main():
    for path in (HERE / "corpus").glob("*/*"):
        if not path.name.startswith("found-"):
            path.unlink()
    for make in (containers, options, manifests, checkpoints, graphs, rigs):
        make()
    size = sum(path.stat().st_size for path in (HERE / "corpus").glob("*/*"))
    print(f"{size} bytes in fuzz/corpus")


if __name__ == "__main__":
    main()
