"""Write files and folders whole or not at all: under a temporary name beside their place, then a rename."""

from __future__ import annotations

import errno
import functools
import hashlib
import json
import os
import re
import secrets
import shutil
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ABANDONED = 24 * 3600
"""Seconds after which a temporary file that nobody touches is a killed process' (of one on this machine: at once)."""

_LEFT = r"-(?:(?P<machine>[0-9a-f]{8})-(?P<process>\d+)-)?[0-9a-f]{8}"


def _share(file: Path) -> None:
    """Give a file that a library wrote for its owner alone, as safetensors does, the permissions of a new file."""
    if os.name == "nt" or file.stat().st_mode & 0o077:
        return
    beside = file.with_name(f"{file.name}.mode")
    beside.touch()
    try:
        file.chmod(stat.S_IMODE(beside.stat().st_mode))
    finally:
        beside.unlink()


@contextmanager
def replacing(path: str | Path, *, sole: bool = False, sync: bool = False) -> Iterator[Path]:
    """Yield a temporary name beside `path`; the file written there takes its place on success, and vanishes on failure.

    Parent folders are made. The temporary name keeps the suffix, since encoders choose their format by it. `sole`: no
    other process writes this file, and what a killed one left is overwritten; without it, what dead processes left is
    removed. `sync`: it is on disk before the rename. Raises OSError naming the file and the fix if the disk is full.
    """
    path = Path(path)
    with needing_room(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left(path.parent, path.stem, path.suffix)
        temporary = path.with_name(f".{path.stem}-{_tag(sole)}{path.suffix}")
        try:
            yield temporary
            if sync:
                with temporary.open("r+b") as file:
                    os.fsync(file.fileno())
            _share(temporary)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def staging_folder(path: str | Path, *, sole: bool = False) -> Iterator[Path]:
    """Yield an empty folder beside `path`, to be renamed to it; it is gone afterwards if nothing renamed it.

    `sole`, what killed processes left, and a full disk as for files.
    """
    path = Path(path)
    with needing_room(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_left(path.parent, path.name)
        staging = path.with_name(f".{path.name}-{_tag(sole)}")
        if sole:
            shutil.rmtree(staging, ignore_errors=True)
        staging.mkdir()
        try:
            yield staging
        finally:
            shutil.rmtree(staging, ignore_errors=True)


@contextmanager
def new_folder(path: str | Path, *, sole: bool = False, replace: bool = False) -> Iterator[Path]:
    """Yield a folder that becomes `path` on success and vanishes on failure.

    Raises ValueError if `path` exists, unless it is to be replaced.
    """
    path = Path(path)
    if path.exists() and not replace:
        raise ValueError(f"{path} exists; choose another folder or remove it")
    with staging_folder(path, sole=sole) as staging:
        yield staging
        with staging_folder(path) as before:
            if path.exists():
                os.replace(path, before / path.name)
            os.replace(staging, path)


def write_text(path: str | Path, text: str) -> Path:
    """Write UTF-8 text with Unix line ends, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def write_json(path: str | Path, value: Any) -> Path:
    """Write plain data as JSON with sorted keys, whole or not at all."""
    return write_text(path, json.dumps(value, indent=1, sort_keys=True) + "\n")


@contextmanager
def needing_room(path: str | Path) -> Iterator[None]:
    """Name what could not be written, and the fix, where the system says no more than that the disk is full."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT) or error.strerror != os.strerror(error.errno):
            raise
        told = f"{error.strerror}: {path} is not written; free disk space or choose another folder, and run again"
        raise OSError(error.errno, told) from error


def _tag(sole: bool) -> str:
    """Tell the temporary names of several writers apart, and who they are."""
    return "partial" if sole else f"{_machine()}-{os.getpid()}-{secrets.token_hex(4)}"


def _remove_left(folder: Path, name: str, suffix: str = "") -> None:
    """Remove what killed processes left of a file or folder that is about to be written."""
    pattern = re.compile(re.escape(f".{name}") + _LEFT + re.escape(suffix))
    for found in _temporary(os.path.abspath(folder)):
        match = pattern.fullmatch(found)
        if match is None or not _is_left(folder / found, match["machine"], match["process"]):
            continue
        if (folder / found).is_dir():
            shutil.rmtree(folder / found, ignore_errors=True)
        else:
            (folder / found).unlink(missing_ok=True)


@functools.lru_cache(maxsize=256)
def _temporary(folder: str) -> tuple[str, ...]:
    """List a folder's temporary names as this process first saw it: a listing a file would be quadratic."""
    some = re.compile(r"\..+" + _LEFT + r"(\..*)?", re.DOTALL)
    return tuple(name for name in os.listdir(folder) if some.fullmatch(name))


def _is_left(path: Path, machine: str | None, process: str | None) -> bool:
    if machine == _machine() and Path("/proc/self").exists():
        return not Path(f"/proc/{process}").exists()
    try:
        return time.time() - path.stat().st_mtime > ABANDONED
    except FileNotFoundError:  # its writer was just done
        return False


@functools.cache
def _machine() -> str:
    """Name this machine and what counts its processes: a container has numbers of its own."""
    known = [socket.gethostname()]
    for place in ("/proc/sys/kernel/random/boot_id", "/proc/self/ns/pid"):
        path = Path(place)
        if path.exists():
            known.append(os.readlink(path) if path.is_symlink() else path.read_text())
    return hashlib.sha256("\n".join(known).encode()).hexdigest()[:8]
