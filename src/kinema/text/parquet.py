"""Read a column of strings from a parquet file: the part of the format that the GloVe wheel's word list needs.

The wheel brings 400,000 words in one snappy-compressed parquet column; pyarrow, which could read it, is a 45 MB install
for one list. Source: the Apache Parquet, Thrift compact protocol and Snappy format descriptions.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MAGIC = b"PAR1"
PLAIN, PLAIN_DICTIONARY, RLE_DICTIONARY = 0, 2, 8
UNCOMPRESSED, SNAPPY = 0, 1
DATA_PAGE, DICTIONARY_PAGE = 0, 2


def read_strings(path: Path, column: int = 0) -> list[str]:
    """Read one column of non-null strings. Raises ValueError for what this reader doesn't know."""
    data = path.read_bytes()
    if data[:4] != MAGIC or data[-4:] != MAGIC:
        raise ValueError(f"{path} is no parquet file or was cut off; reinstall the package it came with")
    footer = len(data) - 8 - struct.unpack_from("<I", data, len(data) - 8)[0]
    metadata, _ = read_struct(data, footer)
    values: list[bytes] = []
    for group in metadata[4]:
        chunk = group[1][column][3]
        if chunk[4] not in (UNCOMPRESSED, SNAPPY):
            raise ValueError(f"{path}: compression {chunk[4]} is not read here; write it with snappy")
        values += _read_chunk(data, chunk, str(path))
    return [value.decode() for value in values]


def _read_chunk(data: bytes, chunk: dict[int, Any], path: str) -> list[bytes]:
    at = min(chunk[9], chunk.get(11, chunk[9]))
    values: list[bytes] = []
    dictionary: list[bytes] = []
    while len(values) < chunk[5]:
        header, start = read_struct(data, at)
        at = start + header[3]
        page = data[start:at] if chunk[4] == UNCOMPRESSED else snappy_decompress(data[start:at])
        if header[1] == DICTIONARY_PAGE:
            dictionary = list(_plain(page, 0))
        elif header[1] == DATA_PAGE:
            count, encoding = header[5][1], header[5][2]
            first = 4 + struct.unpack_from("<I", page)[0]  # skip the definition levels: no value is null
            if encoding == PLAIN:
                found = list(_plain(page, first))
            elif encoding in (PLAIN_DICTIONARY, RLE_DICTIONARY):
                found = [dictionary[i] for i in _hybrid(page, first + 1, page[first], count)]
            else:
                raise ValueError(f"{path}: encoding {encoding} is not read here; write it plain")
            if len(found) != count:
                raise ValueError(f"{path}: a page holds {len(found)} values instead of {count}; null values?")
            values += found
        else:
            raise ValueError(f"{path}: page type {header[1]} is not read here; write data pages of version 1")
    return values


def _plain(page: bytes, at: int) -> Iterator[bytes]:
    """Read length-prefixed byte strings up to the end of the page."""
    while at < len(page):
        end = at + 4 + int.from_bytes(page[at : at + 4], "little")
        yield page[at + 4 : end]
        at = end


def _hybrid(page: bytes, at: int, width: int, count: int) -> list[int]:
    """Read `count` integers of the run-length / bit-packed hybrid encoding."""
    out: list[int] = []
    while len(out) < count:
        header, at = _varint(page, at)
        if header & 1:  # groups of eight, bit-packed
            size = (header >> 1) * width
            bits, mask = int.from_bytes(page[at : at + size], "little"), (1 << width) - 1
            for _ in range((header >> 1) * 8):
                out.append(bits & mask)
                bits >>= width
        else:
            size = (width + 7) // 8
            out += [int.from_bytes(page[at : at + size], "little")] * (header >> 1)
        at += size
    return out[:count]


def snappy_decompress(data: bytes) -> bytes:
    """Decompress one raw snappy block."""
    size, at = _varint(data, 0)
    out = bytearray()
    while at < len(data):
        tag = data[at]
        at += 1
        kind = tag & 3
        if kind == 0:  # literal
            length = (tag >> 2) + 1
            if length > 60:
                extra = length - 60
                length = int.from_bytes(data[at : at + extra], "little") + 1
                at += extra
            out += data[at : at + length]
            at += length
            continue
        if kind == 1:
            length, offset = ((tag >> 2) & 7) + 4, (tag >> 5) << 8 | data[at]
            at += 1
        else:
            extra = 2 if kind == 2 else 4
            length, offset = (tag >> 2) + 1, int.from_bytes(data[at : at + extra], "little")
            at += extra
        start = len(out) - offset
        piece = out[start : start + length]
        if len(piece) < length:  # the copy overlaps what it writes
            piece = (piece * (length // len(piece) + 1))[:length]
        out += piece
    if len(out) != size:
        raise ValueError(f"a snappy block holds {len(out)} bytes instead of {size}: the file is damaged")
    return bytes(out)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
        shift += 7


def _zigzag(data: bytes, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return (value >> 1) ^ -(value & 1), at


def read_struct(data: bytes, at: int) -> tuple[dict[int, Any], int]:
    """Read one Thrift compact struct as {field id: value}; gives the position behind it."""
    fields: dict[int, Any] = {}
    field = 0
    while data[at] != 0:
        head = data[at]
        at += 1
        if head >> 4:
            field += head >> 4
        else:
            field, at = _zigzag(data, at)
        fields[field], at = _read_value(data, at, head & 15)
    return fields, at + 1


def _read_value(data: bytes, at: int, kind: int) -> tuple[Any, int]:
    if kind in (1, 2):  # true, false
        return kind == 1, at
    if kind == 3:
        return data[at], at + 1
    if kind in (4, 5, 6):
        return _zigzag(data, at)
    if kind == 7:
        return struct.unpack_from("<d", data, at)[0], at + 8
    if kind == 8:
        size, at = _varint(data, at)
        return data[at : at + size], at + size
    if kind in (9, 10):
        size, element = data[at] >> 4, data[at] & 15
        size, at = _varint(data, at + 1) if size == 15 else (size, at + 1)
        items = []
        for _ in range(size):
            item, at = _read_value(data, at, element)
            items.append(item)
        return items, at
    if kind == 12:
        return read_struct(data, at)
    raise ValueError(f"Thrift type {kind} is not read here: the file is damaged or of another format")
