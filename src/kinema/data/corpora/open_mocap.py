"""Rebuild open-mocap from public captures (OPEN_MOCAP): which file, which frames, which split, which captions.

The recipe (open_mocap.jsonl.xz) has one line per clip. Positions are interpolated linearly, at the source's own rate.
"""

from __future__ import annotations

import json
import lzma
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from kinema.atomic import replacing, write_json, write_text
from kinema.data.catalog import SPLITS
from kinema.data.origin import Origin, named_origin
from kinema.motion.captures.mapping import JointMapping, known_mappings
from kinema.motion.captures.reading import read_capture
from kinema.motion.resampling import resampled
from kinema.motion.skeleton import HUMANML3D

RECIPE = Path(__file__).with_name("open_mocap.jsonl.xz")


@dataclass(frozen=True)
class Source:
    """Say how clips of one source are named and read: whose it is, the prefix of the names, files and mapping."""

    owner: str
    prefix: str
    suffix: str
    mapping: str
    foldered: bool = False


SOURCES = {
    "bandai-d1": Source("bandai", "bandai_", ".bvh", "bandai"),
    "bandai-d2": Source("bandai", "bandai_", ".bvh", "bandai"),
    "cmu-amc": Source("cmu", "cmu_", ".amc", "acclaim"),
    "gsim": Source("cmu", "cmugs_", ".amc", "acclaim"),
    "bvh_daz": Source("cmu", "cmu_", ".bvh", "daz"),
    "acrnn": Source("cmu", "cmuacrnn_", ".bvh", "daz", foldered=True),
    "hdm05": Source("hdm05", "hdm05_", ".amc", "acclaim"),
}
OWNERS = ("bandai", "cmu", "hdm05")


@dataclass(frozen=True)
class Recipe:
    """Hold one line of the recipe."""

    name: str
    source: str
    licence: str
    label: str
    frames: int
    split: str
    compositional: str
    captions: tuple[str, ...]

    @property
    def kind(self) -> Source:
        """How clips of its source are named and read."""
        return SOURCES[self.source]

    @cached_property
    def origin(self) -> Origin:
        """The take that it is a piece of, by name, and the piece's first frame at 20 fps."""
        return named_origin(self.name)

    @property
    def file(self) -> str:
        """The end of the path of its capture, in small letters: `02_01.amc`, `indian/06.bvh`."""
        stem = self.origin.take.removeprefix(self.kind.prefix)
        return (stem.replace("_", "/") if self.kind.foldered else stem).lower() + self.kind.suffix

    @property
    def manifest(self) -> dict[str, Any]:
        """What manifest.json says of the clip."""
        kept = ("name", "source", "licence", "label", "frames", "split")
        return {key: getattr(self, key) for key in kept}


def read_recipe() -> list[Recipe]:
    """Read all clips of the corpus, by name."""
    lines = map(json.loads, lzma.decompress(RECIPE.read_bytes()).decode().splitlines())
    return sorted((Recipe(**{**line, "captions": tuple(line["captions"])}) for line in lines), key=lambda r: r.name)


@dataclass(frozen=True)
class Rebuilt:
    """Say how much of the corpus could be rebuilt: clips by owner and of all, and what is missing and why."""

    folder: Path
    made: dict[str, int]
    wanted: dict[str, int]
    licences: dict[str, int]
    missing: dict[str, str]

    @property
    def whole(self) -> bool:
        """Whether no clip is missing."""
        return not self.missing

    def __str__(self) -> str:
        """Lines for people: counts by owner, licences, what is missing."""
        counts = ", ".join(f"{owner} {self.made[owner]} of {self.wanted[owner]}" for owner in OWNERS)
        name = "open-mocap" if self.whole else f"a subset of open-mocap ({self.subset})"
        lines = [f"{self.folder}: {name}; clips: {counts}"]
        lines += [f"licence   {licence}: {count} clips" for licence, count in sorted(self.licences.items())]
        if not self.whole:
            first = ", ".join(list(self.missing)[:3])
            lines.append(f"missing   {len(self.missing)} clips (missing.txt says why), first {first}")
        return "\n".join(lines)

    @property
    def subset(self) -> str:
        """Name what is there by the owners: `bandai`, `bandai+cmu` or, of an owner with gaps, `bandai+cmu(250)`."""
        return "+".join(
            owner if self.made[owner] == self.wanted[owner] else f"{owner}({self.made[owner]})"
            for owner in OWNERS
            if self.made[owner]
        )


def rebuild(
    folders: dict[str, list[Path]],
    out: Path,
    *,
    pool: Executor | None = None,
    watch: Callable[[Iterable[Any], int], Iterable[Any]] = lambda results, total: results,
) -> Rebuilt:
    """Write the corpus folder from the owners' folders (bandai, cmu, hdm05), in the joints-folder layout.

    Clips that are there are not made again; `watch` passes takes on and shows how far they are. Raises ValueError if
    the folders hold no capture of the corpus.
    """
    recipe = read_recipe()
    files = {owner: _files(folders.get(owner, [])) for owner in OWNERS}
    takes: dict[str, list[Recipe]] = {}
    for clip in recipe:
        takes.setdefault(clip.origin.take, []).append(clip)
    jobs = [(clips, _found(files[clips[0].kind.owner], clips[0].file), out) for clips in takes.values()]
    if not any(found for _, found, _ in jobs):
        given = ", ".join(str(folder) for owner in OWNERS for folder in folders.get(owner, [])) or "no folder"
        raise ValueError(
            f"{given} holds no capture of open-mocap; it looks below the folders for files such as {recipe[0].file}, "
            "02_01.amc or HDM_bd_depositFloorR_001_120.amc"
        )
    missing: dict[str, str] = {}
    results = map(_make, jobs) if pool is None else pool.map(_make, jobs, chunksize=4)
    for lacking in watch(results, len(jobs)):
        missing |= lacking
    made = [clip for clip in recipe if clip.name not in missing]
    _write_lists(made, missing, out)
    return Rebuilt(
        out,
        made=Counter(clip.kind.owner for clip in made),
        wanted=Counter(clip.kind.owner for clip in recipe),
        licences=Counter(clip.licence for clip in made),
        missing=missing,
    )


def _files(folders: Iterable[Path]) -> dict[str, list[Path]]:
    """List the captures below folders by their names in small letters."""
    found: dict[str, list[Path]] = {}
    for folder in folders:
        if not folder.is_dir():
            raise FileNotFoundError(f"no such folder: {folder}")
        for path in sorted(folder.rglob("*")):
            if path.suffix.lower() in (".bvh", ".amc"):
                found.setdefault(path.name.lower(), []).append(path)
    return found


def _found(files: dict[str, list[Path]], wanted: str) -> list[Path]:
    """Find the files whose path ends in `wanted`."""
    named = files.get(wanted.rpartition("/")[2], [])
    return [path for path in named if path.as_posix().lower().endswith(f"/{wanted}")]


def _make(job: tuple[list[Recipe], list[Path], Path]) -> dict[str, str]:
    """Write the pieces of one take; give those that couldn't be made and why."""
    clips, found, out = job
    # A clip of an earlier call is whole: a rename is the last thing that writing it does.
    clips = [clip for clip in clips if not _array(clip, out).is_file()]
    if not clips:
        return {}
    if not found:
        return {clip.name: f"no file {clip.file}" for clip in clips}
    reasons = []
    for path in found:
        try:
            joints = take_joints(path, known_mappings()[clips[0].kind.mapping])
        except (OSError, ValueError) as error:
            reasons.append(str(error))
            continue
        missing = {}
        for clip in clips:
            piece = joints[clip.origin.start : clip.origin.start + clip.frames]
            if len(piece) < clip.frames:
                missing[clip.name] = (
                    f"{path} has {len(joints)} frames at 20 fps; {clip.origin.start + clip.frames} are needed"
                )
                continue
            with replacing(_array(clip, out)) as temporary, temporary.open("wb") as file:
                np.save(file, piece.astype(np.float32), allow_pickle=False)
        return missing
    return {clip.name: "; ".join(reasons) for clip in clips}


def take_joints(path: Path, mapping: JointMapping) -> Float[np.ndarray, "t j 3"]:
    """Read a whole take as the corpus has it: 20 fps, metres, tenths of a millimetre."""
    capture = read_capture(path)
    lacking = mapping.lacking(capture.names)
    if lacking or mapping.scale is None:
        raise ValueError(f"{path} is no file of {mapping.title}: it lacks {', '.join(lacking[:3])}")
    weights = mapping.weights(capture.names, HUMANML3D)
    positions = np.einsum("js,tsc->tjc", weights, capture.part(mapping.skip_frames).positions)
    return np.round(resampled(positions * mapping.scale, capture.fps, HUMANML3D.fps), 4)


def _array(clip: Recipe, out: Path) -> Path:
    return out / "joints" / f"{clip.name}.npy"


def _write_lists(made: list[Recipe], missing: dict[str, str], out: Path) -> None:
    """Write captions, split files and manifest of the clips that are there, and say which aren't."""
    for clip in made:
        write_text(out / "texts" / f"{clip.name}.txt", "".join(f"{caption}\n" for caption in clip.captions))
    for split in SPLITS:
        write_text(out / f"{split}.txt", _names(c for c in made if c.split == split))
        write_text(out / "compositional" / f"{split}.txt", _names(c for c in made if c.compositional == split))
    write_json(out / "manifest.json", [clip.manifest for clip in made])
    reasons = "".join(f"{name}: {reason}\n" for name, reason in sorted(missing.items()))
    if missing:
        write_text(out / "missing.txt", reasons)
    else:
        (out / "missing.txt").unlink(missing_ok=True)


def _names(clips: Iterable[Recipe]) -> str:
    return "".join(f"{clip.name}\n" for clip in clips)
