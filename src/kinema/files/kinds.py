"""Say what a file is that isn't what it should be, and refuse it in one line."""

from __future__ import annotations

import codecs
from pathlib import Path

HEAD = 512
"""Bytes at the start of a file that tell its kind."""

_STARTS = (
    (b"version https://git-lfs", "is a Git LFS pointer, not the file itself (`git lfs pull` fetches that)"),
    (b"\x93NUMPY", "is a NumPy array (.npy)"),
    (b"PK\x03\x04", "is a zip archive (.npz, or a checkpoint of torch)"),
    (b"\x1f\x8b", "is compressed (gzip); unpack it"),
    (b"\x89PNG", "is an image"),
    (b"%PDF", "is a PDF"),
    (b"HIERARCHY", "is a BVH file"),
    (b"\x80", "is a Python pickle, which could run code and is not loaded"),
)


class DamagedError(ValueError):
    """A file does not hold what it should; the message names the file, what is wrong and the fix."""


def refuse(path: Path | str, what: str, fix: str) -> DamagedError:
    """Make the error of a file: its name, what is wrong and what to do, in one line."""
    return DamagedError(f"{path} {' '.join(what.split())}; {fix}")


def require_file(path: str | Path, fix: str) -> Path:
    """Return the path of a file that is there; raises FileNotFoundError if it isn't, or is a folder or a device."""
    path = Path(path)
    if not path.is_file():
        state = "is a folder, not a file" if path.is_dir() else "is no regular file" if path.exists() else "is missing"
        raise FileNotFoundError(f"{path} {state}; {fix}")
    return path


def describe(head: bytes) -> str:
    """Say what a file is by its first bytes: empty, a pointer, a web page, text, or unknown."""
    if not head:
        return "is empty"
    for start, what in _STARTS:
        if head.startswith(start):
            return what
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith((b"<!doctype html", b"<html", b"<head", b"<?xml")):
        return "is a web page, not the file itself (a quota, a login or an error of the server?)"
    if not text.strip(b"\0"):
        return "holds nothing but zeros or spaces"
    return "is text" if _is_text(head) else "is of an unknown kind"


def _is_text(head: bytes) -> bool:
    try:
        text = codecs.getincrementaldecoder("utf-8")().decode(head)  # the last character may be cut in two
    except UnicodeDecodeError:
        return False
    return all(letter >= " " or letter in "\t\r\n\f" for letter in text)


def head_of(path: Path) -> bytes:
    """Read the first bytes of a file."""
    with path.open("rb") as file:
        return file.read(HEAD)


def size(count: float) -> str:
    """Write a number of bytes."""
    for unit in ("bytes", "kB", "MB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "bytes" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"
