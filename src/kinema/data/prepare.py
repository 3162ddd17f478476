"""Turn any corpus into a packed store: features, index, captions, statistics and a manifest, whole or not at all."""

from __future__ import annotations

import errno
import hashlib
import importlib
import inspect
import json
import multiprocessing
import os
import re
import shutil
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from kinema.atomic import staging_folder
from kinema.data.catalog import Catalog, Clip, Dropped
from kinema.data.convert import VERSION as FEATURES
from kinema.data.convert import Converted, convert
from kinema.data.folders import walk
from kinema.data.leftout import MAX_UNUSABLE, check_share, told_of
from kinema.data.origin import index_file
from kinema.data.packing import StoreWriter
from kinema.data.store import FORMAT, PackedStore, read_manifest
from kinema.locks import hold
from kinema.motion.skeleton import get_skeleton
from kinema.options import Share, Threads, check

VERSION = 1
"""Raised when preparing the same corpus gives another store, so that stores made before are not taken for it."""

READERS = {
    "joints": "kinema.data.catalog:read_joints_folder",
    "captures": "kinema.data.captures:read_captures",
    "official": "kinema.data.catalog:read_official",
    "synthetic": "kinema.data.synthetic:synthetic_catalog",
}
"""Readers by name: `reader(source, **options) -> Catalog`; add a corpus format here.

A reader that takes a `skeleton` is given the corpus'. The `VERSION` of a reader's module, if it has one, is part of a
request: raise it when the same source gives other clips.
"""


LIMITS = ("legacy_fps", "max_missing", "max_unusable", "processes")
"""Options of `prepare` that the configuration's `data.options` may hold beside the reader's."""


def find_reader(name: str) -> Callable[..., Catalog]:
    """Find a reader; raises ValueError naming those there are."""
    if name not in READERS:
        raise ValueError(f"unknown reader {name!r}; choose one of {', '.join(READERS)}")
    module, _, function = READERS[name].partition(":")
    return getattr(importlib.import_module(module), function)


def takes(name: str, option: str) -> bool:
    """Say whether a reader has an option."""
    return option in inspect.signature(find_reader(name)).parameters


def check_reader(name: str, options: Mapping[str, Any], at: str = "", *others: str) -> None:
    """Raise ValueError naming an option under `at` that is wrong, or neither a reader's nor one of `others`."""
    read, given = find_reader(name), {key: value for key, value in options.items() if value is not None}
    known = {*inspect.signature(read).parameters, *others} - {"path", "skeleton"}
    for key in given:
        if key not in known:
            hint = ": features have the skeleton's rate, joints folders are resampled" if key == "fps" else ""
            raise ValueError(
                f"{at and f'{at}.'}{key} is no option; reader {name} has {', '.join(sorted(known)) or 'none'}{hint}"
            )
    check(read, given, at)


def prepare_store(
    reader: str,
    source: str | Path | None,
    out_root: str | Path,
    *,
    name: str,
    skeleton: str = "humanml3d",
    mirror: bool | None = None,
    legacy_fps: bool = False,
    max_missing: Share = 0.05,
    max_unusable: Share = MAX_UNUSABLE,
    processes: Threads = 1,
    listing: str | None = None,
    **reader_options: Any,
) -> Path:
    """Prepare a corpus below `out_root`, or give the store that the same request made before.

    The request is the reader, the options, and names, sizes and times of the source's files, or the `listing` of them
    that the caller has; `source` is None for a corpus that is generated. `mirror` defaults to True, except for official
    folders, which hold their mirrored clips already. The other options are those of `prepare`; what is left goes to
    the reader.
    """
    mirror = reader != "official" if mirror is None else mirror
    options: dict[str, Any] = {"name": name, "skeleton": skeleton, "mirror": mirror, "legacy_fps": legacy_fps}
    if takes(reader, "skeleton"):
        reader_options["skeleton"] = skeleton
    module, _, _ = READERS[reader].partition(":")
    versions = [FORMAT, FEATURES, VERSION, getattr(importlib.import_module(module), "VERSION", 1)]
    asked = [versions, reader, options, max_missing, max_unusable, reader_options]
    asked.append(list_files(source) if listing is None else listing)
    asked += [_stamp(value) for value in reader_options.values() if isinstance(value, str) and Path(value).is_file()]
    request = hashlib.sha256(json.dumps(asked, sort_keys=True, default=str).encode()).hexdigest()[:12]
    out = Path(out_root) / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', name)}-{request}"
    if _request_of(out) == request:
        return out
    catalog = read_corpus(reader, source, **reader_options)
    options |= {"max_missing": max_missing, "max_unusable": max_unusable}
    return prepare(catalog, out, **options, processes=processes, request=request)


def read_corpus(reader: str, source: str | Path | None, **options: Any) -> Catalog:
    """Read a corpus with one of the `READERS`; raises ValueError for an option that it doesn't take."""
    check_reader(reader, {key: value for key, value in options.items() if key != "skeleton"})
    read = find_reader(reader)
    return read(**options) if source is None else read(source, **options)


def prepare(
    clips: Catalog | Iterable[Clip],
    out_dir: str | Path,
    *,
    name: str,
    skeleton: str = "humanml3d",
    mirror: bool = True,
    legacy_fps: bool = False,
    max_missing: Share = 0.05,
    max_unusable: Share = MAX_UNUSABLE,
    processes: Threads = 1,
    request: str | None = None,
) -> Path:
    """Write clips as a packed store at `out_dir`; nothing half-written stays, whatever happens.

    Clips of joints are checked and turned into features; with `mirror`, also left-right mirrored under `MNAME`, with
    their captions. `legacy_fps` reads time tags at 20 fps for every corpus, as published for KIT. `processes` changes
    only the time it takes. A store that the same `request` made is given back at once.

    Raises ValueError if no clip is usable, if more than the share `max_missing` of the listed clips lacks its files
    or more than `max_unusable` holds no sound motion, or if `out_dir` holds another content. What else is left out is
    printed, and listed in the store's dropped.json.
    """
    check(prepare, {"max_missing": max_missing, "max_unusable": max_unusable, "processes": processes}, "prepare")
    out, body = Path(out_dir), get_skeleton(skeleton)
    catalog = clips if isinstance(clips, Catalog) else Catalog(list(clips))
    _check_catalog(catalog, name, mirror, max_missing)
    told = f"waiting   {out}: another process prepares it"
    with hold(out.with_name(f".{out.name}.lock"), waiting=lambda: print(told, flush=True)):
        if request is not None and _request_of(out) == request:
            return out
        with staging_folder(out, sole=True) as staging:
            writer = StoreWriter(staging, name, body, tag_fps=20.0 if legacy_fps else body.fps)
            options = {"request": request, "mirror": mirror, "legacy_fps": legacy_fps}
            manifest = _write(catalog, writer, options, max_unusable, processes)
            _move(staging, out, manifest)
    for line in told_of(catalog, writer.dropped, manifest, out):
        print(line, flush=True)
    return out


def _check_catalog(catalog: Catalog, name: str, mirror: bool, max_missing: float) -> None:
    missing = [d for d in catalog.dropped if d.what == "missing"]
    listed = len(catalog) + len(missing)
    if len(missing) > max_missing * listed:
        raise ValueError(
            f"corpus {name!r}: {len(missing)} of {listed} listed clips lack their files, more than the allowed share "
            f"{max_missing:g} (first, {missing[0].name}: {missing[0].reason}); complete the folder or raise max_missing"
        )
    if mirror and any(clip.features is not None for clip in catalog):
        raise ValueError(
            f"corpus {name!r}: clips that come as features cannot be mirrored (official folders hold their mirrored "
            "clips already); pass mirror=False, or prepare from joints"
        )


def _write(
    catalog: Catalog, writer: StoreWriter, options: dict[str, Any], max_unusable: float, processes: int
) -> dict[str, Any]:
    """Write every file of the store; if the disk is full, say how much room is needed."""
    taken = {clip.name for clip in catalog}
    jobs = [(clip, writer.skeleton.name, options["mirror"] and _unmirrored(clip, taken)) for clip in catalog]
    try:
        for dropped in catalog.dropped:
            writer.drop(dropped)
        for clip, made in zip(catalog, _convert_all(jobs, processes), strict=True):
            if isinstance(made, Dropped):
                writer.drop(made)
                continue
            writer.add(clip, made.features, made.digest)
            if made.mirrored is not None:
                captions = [caption.mirrored() for caption in clip.captions]
                image = replace(clip, name=f"M{clip.name}", captions=captions, mirrored=True)
                writer.add(image, made.mirrored, made.digest)
        unread = sum(dropped.what == "clip" for dropped in catalog.dropped)  # by the reader: no clips of the catalog
        check_share(writer.name, writer.dropped, len(catalog) + unread, max_unusable)
        return writer.finish(catalog.statistics, options)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        raise OSError(errno.ENOSPC, _no_room(writer, len(catalog) * (2 if options["mirror"] else 1))) from error
    finally:
        writer.close()


def _no_room(writer: StoreWriter, clips: int) -> str:
    needed = writer.bytes_per_clip() * clips / 1e9
    free = shutil.disk_usage(writer.folder.parent).free / 1e9
    return (
        f"no room left below {writer.folder.parent} for corpus {writer.name!r}: it needs about {needed:.2f} GB, "
        f"{free:.2f} GB are free now; nothing was kept. Free some room or choose another folder"
    )


def _unmirrored(clip: Clip, taken: set[str]) -> bool:
    return not clip.mirrored and f"M{clip.name}" not in taken


def _convert_all(jobs: list[tuple[Clip, str, bool]], processes: int) -> Iterator[Dropped | Converted]:
    """Do the jobs in order, in this process or in several."""
    if processes <= 1:
        yield from map(convert, jobs)
        return
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn, initializer=_end_with_parent) as pool:
        yield from pool.map(convert, jobs, chunksize=16)


def _end_with_parent() -> None:
    """End this process when the one that started it does, killed or not: it would wait for work for ever."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _move(staging: Path, out: Path, manifest: dict[str, Any]) -> None:
    """Put the finished store in its place, and in that of one of the same motion of which less or else was known."""
    if not out.exists():
        os.replace(staging, out)
    elif not (out / "manifest.json").is_file():
        raise ValueError(f"{out} exists and is no packed corpus; choose another folder")
    elif PackedStore.open(out).hash != manifest["hash"]:
        raise ValueError(f"{out} holds a corpus of another content; delete it or choose another folder")
    elif any(read_manifest(out)[key] != manifest[key] for key in ("name", "options", "checksums")):
        with staging_folder(out) as before:  # who reads the old one still has its files open
            os.replace(out, before / out.name)
            os.replace(staging, out)


def _request_of(store: Path) -> str | None:
    """Return the request that made a store, None where there is no store."""
    file = store / "manifest.json"
    return read_manifest(store)["options"]["request"] if file.is_file() else None


def list_files(source: str | Path | None) -> str:
    """Name a source's files without reading them: a hash of the paths below it and of its index, sizes and times."""
    if source is None:
        return ""
    root, found = Path(source), hashlib.sha256()
    for folder, files in walk(root):
        below = os.path.relpath(folder, root)
        for file in files:
            found.update(f"{below}/{file} {_stamp(os.path.join(folder, file))}\n".encode())
    index = index_file(root)
    if index is not None and index.parent != root.absolute():
        found.update(f"../index.csv {_stamp(index)}\n".encode())
    return found.hexdigest()


def _stamp(file: str | Path) -> str:
    status = os.stat(file)
    return f"{status.st_size} {status.st_mtime_ns}"
