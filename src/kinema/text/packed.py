"""Store text features in append-only files that several processes read and write at once.

A folder holds `pooled.bin` (one row per text), `tokens.bin` (the real tokens of all texts, one after the other),
`index.bin` (one record per text: a header and the text) and `encoder.json` (what made them). Data is written before its
record, so whatever a killed process leaves behind the last whole record is not referred to and is cut off by the next
writer. Readers need no lock. Sizes are those of opened files: by its name, NFS says for up to a minute what a file had
before another machine wrote to it.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from kinema.atomic import needing_room, write_json
from kinema.files.json import read_json
from kinema.files.kinds import DamagedError
from kinema.locks import hold

FORMAT = 1
_HEADER = struct.Struct("<III")  # bytes of the text, tokens, checksum of both and the text


class PackedFeatures:
    """Read and extend one folder of packed features; `index` maps a text to its row."""

    def __init__(self, folder: Path, identity: str, dim: int, token_dim: int, token_dtype: str | None) -> None:
        self.folder, self.dim = folder, dim
        self.token_dim = token_dim if token_dtype else 0
        self.token_dtype = np.dtype(token_dtype or "float32")
        shape = {"dim": dim, "token_dim": token_dim, "token_dtype": token_dtype}
        self._claim({"format": FORMAT, "encoder": identity} | shape)
        self.index: dict[str, int] = {}
        self._ends = [0]  # of each text's tokens; one more than there are records
        self._ends_array = np.array(self._ends)
        self._read = 0
        self.pooled = self.tokens = np.zeros((0, 1), np.float32)
        self.refresh()

    def _claim(self, wanted: dict[str, Any]) -> None:
        """Say whose features these are, or refuse a folder that is another encoder's."""
        path = self.folder / "encoder.json"
        try:
            found = read_json(path)
        except (FileNotFoundError, DamagedError):
            write_json(path, wanted)  # the folder is named by the encoder, so this is what stood there
            return
        if found != wanted:
            raise ValueError(f"text cache {self.folder} holds features of {found}, not of {wanted}; delete the folder")

    @property
    def ends(self) -> np.ndarray:
        """The row in `tokens` behind the last token of each text, 0 in front."""
        if len(self._ends_array) != len(self._ends):
            self._ends_array = np.array(self._ends)
        return self._ends_array

    @property
    def rows(self) -> int:
        """The number of records."""
        return len(self._ends) - 1

    def refresh(self) -> None:
        """Take in the records that other processes have added; stop at one that is not whole."""
        known = self.rows
        for text, end, read in self._added():
            self.index[text] = self.rows
            self._ends.append(end)
            self._read = read
        if self.rows > known:
            self._map()

    def _added(self) -> Iterator[tuple[str, int, int]]:
        """Yield text, end of its tokens and end in `index.bin` of each whole record that isn't taken in."""
        with _opened(self.folder / "index.bin") as file:
            if file is None:
                return
            file.seek(self._read)
            data = file.read()
        rows, token_rows = self._whole_rows("pooled.bin"), self._whole_rows("tokens.bin")
        at, start, row, end = 0, self._read, self.rows, self._ends[-1]
        while at + _HEADER.size <= len(data):
            size, count, checksum = _HEADER.unpack_from(data, at)
            text = data[at + _HEADER.size : at + _HEADER.size + size]
            row, end = row + 1, end + (count if self.token_dim else 0)
            if _checksum(text, count) != checksum or len(text) < size or row > rows or end > token_rows:
                return
            at += _HEADER.size + size
            yield text.decode(), end, start + at

    def _row_bytes(self, name: str) -> int:
        return self.dim * 4 if name == "pooled.bin" else self.token_dim * self.token_dtype.itemsize

    def _whole_rows(self, name: str) -> int:
        width = self._row_bytes(name)
        with _opened(self.folder / name) as file:
            return os.fstat(file.fileno()).st_size // width if width and file is not None else 0

    def _map(self) -> None:
        self.pooled = np.memmap(self.folder / "pooled.bin", np.float32, "r", shape=(self.rows, self.dim))
        if self._ends[-1]:
            shape = (self._ends[-1], self.token_dim)
            self.tokens = np.memmap(self.folder / "tokens.bin", self.token_dtype, "r", shape=shape)

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Hold the folder's lock, with the records of all other writers taken in."""
        with hold(self.folder / "lock"):
            for name in ("pooled.bin", *(["tokens.bin"] if self.token_dim else []), "index.bin"):
                # Made if need be, since NFS asks the server then: else it may still know that there was none.
                _open_for_update(self.folder / name).close()
            self.refresh()
            yield

    def append(self, texts: Sequence[str], pooled: np.ndarray, tokens: Sequence[np.ndarray]) -> None:
        """Add texts that are new; call inside `writing`.

        Raises OSError where whole records would be cut off: what a killed process leaves is less than one.
        """
        if next(self._added(), None) is not None:
            raise OSError(f"{self.folder} has records of another process that were not seen; run the command again")
        records = bytearray()
        for text, rows in zip(texts, tokens, strict=True):
            raw = text.encode()
            records += _HEADER.pack(len(raw), len(rows), _checksum(raw, len(rows))) + raw
        self._write("pooled.bin", self.rows * self._row_bytes("pooled.bin"), pooled.astype(np.float32).tobytes())
        if self.token_dim:
            packed = np.concatenate(tokens).astype(self.token_dtype).tobytes()
            self._write("tokens.bin", self._ends[-1] * self._row_bytes("tokens.bin"), packed)
        self._write("index.bin", self._read, bytes(records))
        self.refresh()

    def _write(self, name: str, at: int, data: bytes) -> None:
        """Write behind the last byte that a whole record refers to; cut off what a killed process left there."""
        with needing_room(self.folder / name), _open_for_update(self.folder / name) as file:
            if os.fstat(file.fileno()).st_size < at:
                raise OSError(f"{self.folder / name} shrank while in use; leave the folder alone and start again")
            file.truncate(at)
            file.seek(at)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())


def _checksum(text: bytes, count: int) -> int:
    """Check a record; never 0 for the zeros that a crash of the machine can leave."""
    return zlib.crc32(text, 1 + count)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[BinaryIO | None]:
    """Open a file to read it; None if there is none."""
    try:
        file = path.open("rb")
    except FileNotFoundError:
        yield None
        return
    with file:
        yield file


def _open_for_update(path: Path) -> BinaryIO:
    return os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "r+b")
