"""Read NumPy's files: a header is checked against the file and what is allowed before anything is allocated."""

from __future__ import annotations

import io
import lzma
import math
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from kinema.files.kinds import DamagedError, describe, head_of, refuse, require_file, size

NUMBERS = "fiu"
"""Kinds of real numbers; `b` are truth values, `U` texts."""

MOST = 4 << 30
"""Bytes that a file may unpack to."""

FIX = "save it again with np.save, as plain numbers"
FIX_NPZ = "save it again with np.savez, as plain arrays"


# What zipfile meets in an archive that is damaged or encrypted.
_DAMAGES = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, RuntimeError, ValueError, OSError)


@dataclass(frozen=True)
class Wanted:
    """Say what an array may be: its dtype, exactly or as a string of kinds, and its shape, None for any size.

    `optional`: an archive may do without it.
    """

    dtype: str | np.dtype = NUMBERS
    shape: tuple[int | None, ...] | None = None
    optional: bool = False

    def fault(self, dtype: np.dtype, shape: tuple[int, ...]) -> str | None:
        """Say what is wrong with an array of this dtype and shape."""
        if dtype.hasobject:
            return "holds Python objects (a pickle, which could run code), not plain numbers"
        if isinstance(self.dtype, np.dtype):
            right, allowed = dtype == self.dtype, str(self.dtype)
        else:
            names = {"f": "floats", "i": "integers", "u": "unsigned integers", "b": "truth values", "U": "texts"}
            right, allowed = dtype.kind in self.dtype, ", ".join(names.get(kind, kind) for kind in self.dtype)
        if not right:
            return f"holds {dtype}, allowed: {allowed}"
        if self.shape is not None and not _fits(shape, self.shape):
            return f"has shape {_shape(shape)}, allowed: {_shape(self.shape)}"
        return None


ANY = Wanted(f"{NUMBERS}bU")
"""Numbers, truth values or texts."""


def read_npy(path: str | Path, wanted: Wanted | None = None, *, most: int = MOST, fix: str = FIX) -> np.ndarray:
    """Read one array; raises FileNotFoundError, or ValueError naming the file, what is wrong and `fix`."""
    path, dtype, shape, fortran, start = _open_npy(path, wanted, fix)
    if (bytes_ := math.prod(shape) * dtype.itemsize) > most:
        raise refuse(path, f"holds {size(bytes_)}, allowed: {size(most)}", fix)
    with path.open("rb") as file:
        file.seek(start)
        return _array(file.read(bytes_), dtype, shape, fortran)


def map_npy(path: str | Path, wanted: Wanted | None = None, *, fix: str = FIX) -> np.ndarray:
    """Map one array into memory, read-only; errors as of `read_npy`."""
    path, dtype, shape, fortran, start = _open_npy(path, wanted, fix)
    if not math.prod(shape):
        return np.zeros(shape, dtype)  # nothing can't be mapped
    return np.memmap(path, dtype, "r", start, shape, "F" if fortran else "C").view(np.ndarray)


def read_npz(
    path: str | Path, wanted: Mapping[str, Wanted] | Wanted = ANY, *, most: int = MOST, fix: str = FIX_NPZ
) -> dict[str, np.ndarray]:
    """Read the arrays of an archive that are `wanted` by name, or all of them, each of which is as one is wanted.

    `most` bytes are unpacked. Raises FileNotFoundError, or ValueError naming the file, what is wrong and `fix`.
    """
    path = require_file(path, fix)
    head = head_of(path)
    if not head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        raise refuse(path, f"{describe(head)}, not an .npz archive", fix)
    try:
        with zipfile.ZipFile(path) as archive:
            return _members(path, archive, wanted, most, fix)
    except DamagedError:
        raise
    except _DAMAGES as error:
        raise refuse(path, f"is a damaged archive ({error or type(error).__name__}): cut off or changed", fix) from None


def _open_npy(path: str | Path, wanted: Wanted | None, fix: str) -> tuple[Path, np.dtype, tuple[int, ...], bool, int]:
    """Check a file's header; returns dtype, shape, whether columns come first, and where the values start."""
    path = require_file(path, fix)
    head = head_of(path)
    if not head.startswith(np.lib.format.MAGIC_PREFIX):
        raise refuse(path, f"{describe(head)}, not an array (.npy)", fix)
    with path.open("rb") as file:
        dtype, shape, fortran = _header(str(path), file, wanted or Wanted(), os.fstat(file.fileno()).st_size, fix)
        return path, dtype, shape, fortran, file.tell()


def _members(
    path: Path, archive: zipfile.ZipFile, wanted: Mapping[str, Wanted] | Wanted, most: int, fix: str
) -> dict[str, np.ndarray]:
    infos = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
    if len(infos) != len(archive.infolist()):
        raise refuse(path, "holds two arrays of one name", fix)
    if isinstance(wanted, Wanted):
        wanted = dict.fromkeys(infos, wanted)
    missing = [name for name, one in wanted.items() if name not in infos and not one.optional]
    if missing:
        raise refuse(path, f"holds no {', '.join(missing)}; it has {', '.join(list(infos)[:12]) or 'nothing'}", fix)
    chosen = [name for name in wanted if name in infos]
    if (total := sum(infos[name].file_size for name in chosen)) > most:
        raise refuse(path, f"unpacks to {size(total)}, allowed: {size(most)}", fix)
    found = {}
    for name in chosen:
        with archive.open(infos[name]) as member:
            dtype, shape, fortran = _header(f"{path}: {name}", member, wanted[name], infos[name].file_size, fix)
            content = member.read()  # never more than the size that was checked; the sum of the member is, too
            found[name] = _array(content, dtype, shape, fortran)
    return found


def _header(
    where: str, file: IO[bytes] | io.BufferedIOBase, wanted: Wanted, total: int, fix: str
) -> tuple[np.dtype, tuple[int, ...], bool]:
    """Read the header of an array that has `total` bytes, and check it; the file then stands at the values."""
    try:
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
        shape, fortran, dtype = read(file)
    except Exception:  # the header is a Python literal: it fails as a tokenizer, a parser or dtype() does
        raise refuse(where, "has a damaged header", fix) from None
    fault = wanted.fault(dtype, shape)
    claimed, present = math.prod(shape) * dtype.itemsize, total - file.tell()
    if fault is None and (claimed != present or min(shape, default=0) < 0):
        fault = f"has a header that claims {size(claimed)} ({dtype} {_shape(shape)}), there are {size(present)}: "
        fault += "cut off or changed"
    if fault is not None:
        raise refuse(where, fault, fix)
    return dtype, shape, fortran


def _array(content: bytes, dtype: np.dtype, shape: tuple[int, ...], fortran: bool) -> np.ndarray:
    return np.frombuffer(bytearray(content), dtype).reshape(shape, order="F" if fortran else "C")


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return len(shape) == len(wanted) and all(w in (None, n) for n, w in zip(shape, wanted, strict=True))


def _shape(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('any' if n is None else str(n) for n in shape)}{',' * (len(shape) == 1)})"
