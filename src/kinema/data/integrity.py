"""Notice that a store's files are no longer those it was written with, whatever their sizes."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import sys
from pathlib import Path
from typing import Any

from kinema.atomic import write_json
from kinema.files.json import Each, read_json
from kinema.files.kinds import DamagedError, refuse

FEATURES = "features.f32"
STAMP = "verified.json"
"""Says what the features' file was like when its content was last checked."""

FIX = "delete the folder and prepare it again"


def check_files(folder: Path, manifest: dict[str, Any]) -> None:
    """Check the content of every small file, and of the features where they changed since they were last checked.

    Raises ValueError naming the file.
    """
    for name, wanted in manifest["sizes"].items():
        file = folder / name
        found = file.stat().st_size if file.is_file() else None
        if found != wanted:
            state = "is missing" if found is None else f"has {found} bytes, {wanted} expected"
            raise DamagedError(f"packed corpus {folder}: {name} {state}; {FIX}")
    for name, wanted in manifest["checksums"].items():
        if name != FEATURES and known_checksum(folder / name) != wanted:
            raise changed(folder, name)
    if _stamp(folder) != _last_stamp(folder):
        # A copy, say, or a store of before there were stamps: seconds, once.
        print(f"checking  {folder / FEATURES}: new here, or changed since it was last checked", file=sys.stderr)
        check_features(folder, manifest)


def check_features(folder: Path, manifest: dict[str, Any]) -> None:
    """Read the features, whatever their stamp says, and renew it; raises ValueError if they aren't those written."""
    stamp = _stamp(folder)
    if known_checksum(folder / FEATURES) != manifest["checksums"][FEATURES]:
        raise changed(folder, FEATURES)
    write_stamp(folder, stamp)


def changed(folder: Path, name: str) -> DamagedError:
    """Make the error of a file whose content is another."""
    what = "was changed: its checksum is no longer that of the manifest"
    return refuse(f"packed corpus {folder}: {name}", what, FIX)


def write_stamp(folder: Path, stamp: dict[str, int] | None = None) -> None:
    """Say that the features' content is what the manifest says."""
    with contextlib.suppress(OSError):  # somebody else's store, or a full disk: every process checks it for itself
        write_json(folder / STAMP, stamp or _stamp(folder))


def checksum(file: Path) -> str:
    """Compute a file's sha256."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _stamp(folder: Path) -> dict[str, int]:
    status = (folder / FEATURES).stat()
    return {"size": status.st_size, "modified": status.st_mtime_ns, "changed": status.st_ctime_ns}


def _last_stamp(folder: Path) -> dict[str, int] | None:
    try:
        return read_json(folder / STAMP, Each(int))
    except (DamagedError, FileNotFoundError):
        return None


def known_checksum(file: Path) -> str:
    """Compute a file's checksum once in a process, as long as the file is the same."""
    status = os.stat(file)
    return _checksum(str(file), status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)


@functools.lru_cache(maxsize=4096)
def _checksum(file: str, *_status: int) -> str:
    return checksum(Path(file))
