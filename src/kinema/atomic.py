"""Write files and folders whole or not at all: under a temporary name beside their place, then a rename."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: str | Path, *, sole: bool = False, sync: bool = False) -> Iterator[Path]:
    """Yield a temporary name beside `path`; the file written there takes its place on success, and vanishes on failure.

    Parent folders are made. The temporary name keeps the suffix, since encoders choose their format by it. `sole`: no
    other process writes this file, and what a killed one left is overwritten. `sync`: it is on disk before the rename.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}-{_tag(sole)}{path.suffix}")
    try:
        yield temporary
        if sync:
            with temporary.open("r+b") as file:
                os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def staging_folder(path: str | Path, *, sole: bool = False) -> Iterator[Path]:
    """Yield an empty folder beside `path`, to be renamed to it; it is gone afterwards if nothing renamed it.

    `sole` as for files: what a killed process left is thrown away.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
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


def _tag(sole: bool) -> str:
    """Tell the temporary names of several writers apart."""
    return "partial" if sole else secrets.token_hex(4)
