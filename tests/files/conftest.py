"""Ways in which a file can be other than it was written: cut, emptied, changed, of another kind, claiming too much."""

from __future__ import annotations

import io
import json
import random
import struct
import zipfile
from collections.abc import Callable, Iterator

import numpy as np
import pytest

Damage = tuple[str, bytes]

OTHERS = {
    "empty": b"",
    "text": b"a person walks\nand sits down\n",
    "pointer": b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 45008\n",
    "page": b"<!DOCTYPE html><html><title>Quota exceeded</title></html>",
    "not UTF-8": b'{"a": "\xff\xfe"}',
    "UTF-16": '{"state": "done"}'.encode("utf-16"),
    "list": b"[]",
    "number": b"3",
    "null": b"null",
    "string": b'"x"',
    "true": b"true",
    "object": b"{}",
    "deep list": b"[" * 20000 + b"]" * 20000,
    "deep object": b'{"a":' * 20000 + b"1" + b"}" * 20000,
    "120 deep": b'{"a":' * 120 + b"1" + b"}" * 120,
    "long number": b'{"a": ' + b"9" * 5000 + b"}",
    "zip of nothing": b"PK\x05\x06" + bytes(18),
    "pickle of code": b"cposix\nsystem\n(S'true'\ntR.",
    "header of 246 GiB": b"\x93NUMPY\x01\x00v\x00"
    + b"{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000, 22, 3), }".ljust(117)
    + b"\n",
    "safetensors of 4 GB": struct.pack("<Q", 1 << 32) + b"{}",
}


def npy(values: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values, allow_pickle=True)
    return stream.getvalue()


ARRAYS = {
    "objects": np.array([{"a": 1}], object),
    "complex": np.zeros((4, 3), complex),
    "texts": np.array(["a", "b"]),
    "scalar": np.float32(1),
    "four axes": np.zeros((2, 2, 2, 2), np.float32),
    "nothing": np.zeros((0, 3), np.float32),
    "dates": np.zeros(3, "datetime64[s]"),
    "rows": np.zeros(2, [("a", "i4")]),
}


def _damages(good: bytes, name: str, seed: int) -> Iterator[Damage]:
    """Give damaged contents of a file: some for any, and those of its kind."""
    draws = random.Random(f"{name} {seed}")
    yield from OTHERS.items()
    for at in sorted(draws.sample(range(1, len(good)), min(8, len(good) - 1))):
        yield f"cut at {at}", good[:at]
    for first, last, times in ((0, min(len(good), 160), 8), (0, len(good), 6)):
        for _ in range(times):
            at, bit = draws.randrange(first, last), draws.randrange(8)
            yield f"bit {bit} of byte {at}", good[:at] + bytes([good[at] ^ 1 << bit]) + good[at + 1 :]
    yield "zeros", bytes(len(good))
    yield "noise", draws.randbytes(len(good))
    yield "longer", good + b"\0\xff"
    if name.endswith(".json"):
        yield from _values(json.loads(good))
    if name.endswith((".npy", ".npz")):
        for kind, values in ARRAYS.items():
            yield f"array: {kind}", npy(values)
    if name.endswith(".npz"):
        yield from _archives(good)


@pytest.fixture(scope="session")
def damages() -> Callable[[bytes, str, int], Iterator[Damage]]:
    """Give what damages a file: its content, its name and a seed make (what, content) pairs."""
    return _damages


def _values(value: dict | list) -> Iterator[Damage]:
    """Give an object without each of its keys, and with other values there."""
    if isinstance(value, dict):
        for key in value:
            yield f"no {key}", json.dumps({k: v for k, v in value.items() if k != key}).encode()
            for other in (None, -1, 2.5, "x", [], {}, True, [[[]]], {"a": "b"}):
                yield f"{key}: {other!r}", json.dumps({**value, key: other}).encode()


def _archives(good: bytes) -> Iterator[Damage]:
    """Give an archive whose arrays are others, one by one, and one that unpacks to 12 GB."""
    with zipfile.ZipFile(io.BytesIO(good)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for name in members:
        yield f"no {name}", _zip({k: v for k, v in members.items() if k != name})
        for kind, values in ARRAYS.items():
            yield f"{name}: {kind}", _zip({**members, name: npy(values)})
        yield f"{name}: claims", _zip({**members, name: OTHERS["header of 246 GiB"]})
        yield f"{name}: text", _zip({**members, name: b"text"})
    yield "a bomb", _bomb(next(iter(members)))


def _zip(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def _bomb(name: str) -> bytes:
    """Write an archive that says it unpacks to 12 GB: the sizes in its directory are what a reader goes by."""
    size = 12_000_000_000
    whole = _zip({name: bytes(100)})
    at = whole.index(b"PK\x01\x02")
    extra = struct.pack("<HHQQ", 1, 16, size, 100)
    entry = bytearray(whole[at : at + 46 + len(name)])
    entry[20:28] = b"\xff" * 8
    entry[30:32] = struct.pack("<H", len(extra))
    end = bytearray(whole[whole.index(b"PK\x05\x06") :])
    end[12:16] = struct.pack("<I", len(entry) + len(extra))
    return whole[:at] + bytes(entry) + extra + bytes(end)
