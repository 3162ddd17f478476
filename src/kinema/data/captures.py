"""Read a folder of captures as a corpus: takes cut into clips, captions from a table, splits by take."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float

from kinema.data.captions import AnnotatedCaption, parse_line
from kinema.data.catalog import SPLITS, Catalog, Clip, Dropped
from kinema.data.folders import visible_files
from kinema.data.integrity import known_checksum
from kinema.data.origin import CUT, Origin
from kinema.data.splitting import split_of
from kinema.files.csv import read_csv
from kinema.motion.captures.amass import BodyModels, read_amass
from kinema.motion.captures.asf import find_asf
from kinema.motion.captures.capture import Capture
from kinema.motion.captures.mapping import read_mapping
from kinema.motion.captures.reading import READERS, Understood, captured_joints, read_capture
from kinema.motion.convention import Convention
from kinema.motion.skeleton import HUMANML3D
from kinema.options import OneOf

VERSION = 2
"""Raised when the reader gives other clips of the same source."""

SUFFIXES = {"bvh": ".bvh", "amc": ".amc", "amass": ".npz"}
"""Files by the name of their format."""

SHARES = (0.8, 0.1, 0.1)
"""Of the takes, where the table says no split."""

TABLE = "write columns file, start, end (seconds, empty: the whole take), caption, and split if you like"


@dataclass(frozen=True)
class Source:
    """Say how a take is read: its file, what is told of its joints, and the body models that AMASS needs."""

    path: Path
    told: Convention
    models: Path | None = None

    def capture(self) -> Capture:
        """Read the file."""
        if self.path.suffix.lower() in READERS:
            return read_capture(self.path)
        return read_amass(self.path, None if self.models is None else BodyModels(self.models))

    def files(self) -> Iterator[Path]:
        """Name all files that its joints depend on."""
        yield self.path
        if self.path.suffix.lower() == ".amc":
            yield find_asf(self.path)
        if self.models is not None:
            yield from sorted(self.models.rglob("*.npz"))
        if self.told.mapping is not None:
            yield Path(self.told.mapping)

    def identity(self) -> str:
        """Name all that its joints depend on, by content: another folder of the same files is the same."""
        contents = " ".join(known_checksum(file) for file in self.files())
        return f"captures {VERSION} {contents} {replace(self.told, mapping=None)}"


@dataclass(frozen=True)
class Cut:
    """Hold one row of the table: seconds [start, end) of a take, None to its end, and what is said of them."""

    start: float
    end: float | None
    captions: tuple[AnnotatedCaption, ...]
    split: str


def read_captures(
    path: str | Path,
    *,
    format: Annotated[str, OneOf(SUFFIXES)] = "bvh",
    captions: str | None = None,
    smplh: str | None = None,
    up: str | None = None,
    scale: Any = None,
    fps: Any = None,
    mapping: str | None = None,
) -> Catalog:
    """Read all captures of a format below a folder: joints by name, unit, upward axis and rate found or told.

    `captions` is a table (CSV) of file, start, end, caption and split; rows of one stretch are its captions. Without it
    every take is cut into pieces of nine seconds without captions. Splits are of takes: no two share one. `smplh` is
    the folder of body models that AMASS needs. Raises ValueError for a table with a wrong row, naming it.
    """
    root = Path(path)
    told = Convention(up=up, scale=scale, fps=fps, mapping=mapping)
    takes = _find_takes(root, SUFFIXES[format])
    if not takes:
        raise FileNotFoundError(f"{root} holds no *{SUFFIXES[format]} (--format {format})")
    shares = {name: split_of(i, SHARES) for i, name in enumerate(sorted(takes))}
    models = None if smplh is None else Path(smplh)
    clips, dropped, seen = list[Clip](), list[Dropped](), list[Understood]()
    cuts = None if captions is None else _read_table(Path(captions), takes)
    wanted = sorted(takes if cuts is None else cuts)
    for name in wanted:
        source = Source(takes[name], told, models)
        try:
            joints, understood = _read(source)
            clips += _clips(name, source, len(joints), None if cuts is None else cuts[name], shares[name])
            seen.append(understood)
        except (ValueError, FileNotFoundError) as error:  # an .amc without its .asf
            dropped.append(Dropped(name, shares[name], "clip", str(error), "capture"))
    _check_names(clips)
    clips.sort(key=lambda clip: SPLITS.index(clip.split))
    others = f"; {len(takes) - len(wanted)} takes are not in the table" if len(wanted) < len(takes) else ""
    return Catalog(clips, dropped, rate=_summary(seen) + others)


def _find_takes(root: Path, suffix: str) -> dict[str, Path]:
    """Find takes by name, in whatever case their suffix is. Raises ValueError for two files of one name."""
    takes: dict[str, Path] = {}
    for file in visible_files(root):
        if not file.lower().endswith(suffix):
            continue
        name = file[: -len(suffix)]
        if name in takes:
            other = takes[name].relative_to(root).as_posix()
            raise ValueError(f"{root} holds {other} and {file}, takes of one name; rename one")
        takes[name] = root / file
    return takes


def _clips(name: str, source: Source, size: int, cuts: list[Cut] | None, split: str) -> Iterator[Clip]:
    """Cut one take: as the table says, or piece by piece."""
    rate, made_from = HUMANML3D.fps, source.identity()
    found: dict[tuple[int, int], list[AnnotatedCaption]] = {}
    if cuts is None:
        found = {(start, min(start + CUT, size)): [] for start in range(0, size, CUT)}
    for cut in cuts or ():  # seconds that are the same frames are one clip
        frames = round(cut.start * rate), size if cut.end is None else round(cut.end * rate)
        found.setdefault(frames, []).extend(cut.captions)
    plain = re.sub(r"[^\w.+-]+", "_", name)
    for (first, last), captions in found.items():
        yield Clip(
            plain if (first, last) == (0, size) else f"{plain}_{first:06d}_{last:06d}",
            cuts[0].split or split if cuts else split,
            captions,
            {"take": name},
            joints=partial(_piece, source, first, last),
            origin=Origin(name, first, last),
            made_from=f"{made_from} {first} {last}",
        )


def _check_names(clips: list[Clip]) -> None:
    """Raise ValueError for takes whose names are one where only letters, digits and `+-.` are left of them."""
    takes: dict[str, str] = {}
    for clip in clips:
        if takes.setdefault(clip.name, clip.fields["take"]) != clip.fields["take"]:
            raise ValueError(
                f"takes {takes[clip.name]!r} and {clip.fields['take']!r} would make clips of one name; rename one"
            )


def _read_table(file: Path, takes: dict[str, Path]) -> dict[str, list[Cut]]:
    """Read the table of captions, the rows of each take."""
    cuts: dict[str, list[Cut]] = {}
    splits: dict[str, str] = {}
    for number, row in enumerate(read_csv(file, "file", "caption", fix=TABLE), 2):
        where = f"{file}, row {number}"
        name = _take(row["file"] or "", takes, where)
        start, end = _seconds(row.get("start"), where) or 0.0, _seconds(row.get("end"), where)
        if end is not None and end <= start:
            raise ValueError(f"{where}: end {end:g} is not after start {start:g}; seconds of the take are meant")
        split = (row.get("split") or "").strip()
        if split and split not in SPLITS:
            raise ValueError(f"{where}: split {split!r}; choose one of {', '.join(SPLITS)}, or leave it empty")
        if splits.setdefault(name, split) != split:
            raise ValueError(f"{where}: {name} is in {splits[name]!r} above; a take belongs to one split")
        caption = (row["caption"] or "").strip()
        try:
            said = (parse_line(caption),) if caption else ()
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None
        cuts.setdefault(name, []).append(Cut(start, end, said, split))
    return cuts


def _take(written: str, takes: dict[str, Path], where: str) -> str:
    """Find the take that a row names: by its path below the folder, or by its name where that is one take's alone."""
    plain = re.sub(r"\.(bvh|amc|npz)$", "", written.strip().replace("\\", "/"), flags=re.IGNORECASE)
    alike = [name for name in takes if name == plain] or [name for name in takes if Path(name).name == plain]
    if len(alike) != 1:
        what = f"is the name of {len(alike)} takes: write its path" if alike else "names no take of the folder"
        raise ValueError(f"{where}: file {written!r} {what}; there are {', '.join(sorted(takes)[:3])}, ...")
    return alike[0]


def _seconds(value: str | None, where: str) -> float | None:
    if value is None or not value.strip():
        return None
    try:
        found = float(value)
    except ValueError:
        found = -1.0
    if not 0 <= found < 1e6:
        raise ValueError(f"{where}: {value!r} is no time; write seconds of the take, or nothing")
    return found


def _piece(source: Source, first: int, last: int) -> Float[np.ndarray, "t 22 3"]:
    joints, _ = _read(source)
    if len(joints) < last:
        raise ValueError(f"{source.path} ends after {len(joints) / HUMANML3D.fps:.1f} s, before the clip does")
    return joints[first:last]


@lru_cache(maxsize=2)
def _read(source: Source) -> tuple[Float[np.ndarray, "t 22 3"], Understood]:
    """Read a take, the last ones kept: a take is cut into many clips."""
    told = source.told
    mapping = None if told.mapping is None else read_mapping(told.mapping)
    joints, understood = captured_joints(
        source.capture(), source.path, mapping=mapping, up=told.up, scale=told.scale, fps=told.fps
    )
    return joints.astype(np.float32), understood


def _summary(seen: list[Understood]) -> str:
    """Say how takes were read, those of one kind together."""
    kinds: dict[str, list[float]] = {}
    for one in seen:
        scale = f"{'guessed ' if one.guessed_scale else ''}scale {one.scale:.4g}"
        kinds.setdefault(f"{one.mapping}, {one.fps:g} fps, {one.up} up, {scale}", []).append(one.height)
    takes = (
        f"{len(heights)} of {kind}, bodies of {min(heights):.2f} to {max(heights):.2f} m"
        for kind, heights in kinds.items()
    )
    return f"takes: {'; '.join(takes)}"
