"""Build HumanML3D from AMASS, HumanAct12 and the published lists (HUMANML3D_DATA §2, §7), in its own folder layout.

Every row of index.csv is a clip; its mirror image is `MNAME`. Captions come with the lists, mirrored ones too.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from kinema.atomic import replacing, write_text
from kinema.data.catalog import SPLITS
from kinema.files.arrays import Wanted, read_npy
from kinema.files.csv import read_csv
from kinema.files.text import read_text
from kinema.motion.captures.amass import BODY, BodyModels, read_amass, strided
from kinema.motion.features import extract
from kinema.motion.mirror import mirror_joints
from kinema.motion.skeleton import HUMANML3D
from kinema.motion.statistics import Statistics

ACTIONS = "humanact12"
NEW_NAMES = {
    "BioMotionLab_NTroje": "BMLrub",
    "DFaust_67": "DFaust",
    "Eyes_Japan_Dataset": "EyesJapanDataset",
    "MPI_HDM05": "HDM05",
    "MPI_Limits": "PosePrior",
    "MPI_mosh": "MoSh",
    "SSM_synced": "SSM",
    "TCD_handMocap": "TCDHands",
    "Transitions_mocap": "Transitions",
}
"""What AMASS calls its sets now, by the names of the lists."""
LEAD_IN = {"Eyes_Japan_Dataset": 3, "MPI_HDM05": 3, "TotalCapture": 1, "MPI_Limits": 1, "Transitions_mocap": 0.5}
"""Seconds of calibration in front, dropped before clips are cut."""
PUBLISHED = {"all": 29228, "train": 23384, "val": 1460, "test": 4384}
"""Names in the published lists."""


@dataclass(frozen=True)
class Cut:
    """Hold a row of index.csv: the source below `pose_data/`, frames [start, end) at 20 fps, the clip's name."""

    source: str
    start: int
    end: int
    name: str

    @property
    def collection(self) -> str:
        """The set of AMASS, or humanact12."""
        return self.source.partition("/")[0]


@dataclass(frozen=True)
class Sources:
    """Hold the user's folders."""

    amass: Path
    models: BodyModels
    actions: Path

    def find(self, source: str) -> Path | None:
        """Find the file of a source under its old or its present name; None if it isn't there."""
        collection, _, rest = source.partition("/")
        stem = rest.removesuffix(".npy")
        if collection == ACTIONS:
            name = f"{Path(stem).name}.npy"
            return next((p for p in (self.actions / name, self.actions / ACTIONS / name) if p.is_file()), None)
        new = stem.removesuffix("_poses") + "_stageii"
        stems = (stem, new, stem.replace(" ", "_"), new.replace(" ", "_"))
        folders = (collection, NEW_NAMES.get(collection, collection))
        places = (self.amass / folder / f"{name}.npz" for folder in folders for name in stems)
        return next((place for place in places if place.is_file()), None)


@dataclass(frozen=True)
class Report:
    """Say what was built: clips, what is missing and why, and the lists' counts beside the published ones."""

    folder: Path
    clips: int
    missing: dict[str, str]
    counts: dict[str, int]

    @property
    def whole(self) -> bool:
        """Whether every listed name has its motion."""
        return not self.missing

    def __str__(self) -> str:
        """Lines for people."""
        lines = [f"{self.folder}: {self.clips} clips, mirrored ones included"]
        for name, count in self.counts.items():
            same = "as published" if count == PUBLISHED[name] else f"published {PUBLISHED[name]}"
            lines.append(f"{name + '.txt':10}{count} names ({same})")
        if self.missing:
            lines.append(f"missing   {len(self.missing)} names of the lists (missing.txt says why)")
        return "\n".join(lines)


def build_humanml3d(
    sources: Sources,
    lists: Path,
    out: Path,
    *,
    pool: Executor | None = None,
    watch: Callable[[Iterable[Any], int], Iterable[Any]] = lambda results, total: results,
) -> Report:
    """Write `new_joint_vecs`, `texts`, `Mean.npy`, `Std.npy`, `index.csv` and the split files below `out`.

    Files of an earlier call are not made again. Clips without a source are left out of the split files and listed.
    Raises FileNotFoundError for lists or body models that are not there, ValueError if no source is.
    """
    cuts, names, texts = read_cuts(lists), _read_names(lists), _texts(lists)
    sources.models.by_gender  # noqa: B018  told before anything is read
    by_source: dict[str, list[Cut]] = {}
    for cut in cuts:
        by_source.setdefault(cut.source, []).append(cut)
    jobs = [(sources, source, clips, out) for source, clips in by_source.items()]
    if not any(sources.find(source) for source in by_source):
        raise ValueError(
            f"{sources.amass} holds no file of the lists, such as {cuts[0].source.replace('.npy', '.npz')}; give the "
            "folder that has AMASS' sets (ACCAD, BMLrub, CMU, ...) unpacked"
        )
    results = map(_make, jobs) if pool is None else pool.map(_make, jobs, chunksize=4)
    missing: dict[str, str] = {}
    for lacking in watch(results, len(jobs)):
        missing |= lacking
    there = {name for name in names["all"] if (out / "new_joint_vecs" / f"{name}.npy").is_file()}
    missing = {
        name: missing.get(name.removeprefix("M"), "no row of index.csv") for name in names["all"] if name not in there
    }
    _finish(out, names, there, texts, missing)
    shutil.copyfile(lists / "index.csv", out / "index.csv")  # of which take a clip is: what a split tests
    return Report(out, len(there), missing, {key: len(values) for key, values in names.items()})


def read_cuts(lists: Path) -> list[Cut]:
    """Read index.csv; raises FileNotFoundError or ValueError naming the file."""
    file = lists / "index.csv"
    if not file.is_file():
        raise FileNotFoundError(
            f"{file} is missing; --lists is HumanML3D's repository, which has index.csv and HumanML3D/"
        )
    rows = read_csv(file)
    try:
        return [
            Cut(
                row["source_path"].removeprefix("./").removeprefix("pose_data/"),
                int(row["start_frame"]),
                int(row["end_frame"]),
                Path(row["new_name"]).stem,
            )
            for row in rows
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{file} needs source_path, start_frame, end_frame and new_name in every row: {error}"
        ) from None


def clip_joints(path: Path, cuts: list[Cut], models: BodyModels) -> Iterator[tuple[Cut, Float[np.ndarray, "t 22 3"]]]:
    """Cut clips out of their source: 20 fps, metres, Y up, as the published `joints/`."""
    if cuts[0].collection == ACTIONS:
        joints = read_npy(path, Wanted("f", (None, None, 3)), fix="copy it again")[:, :BODY].astype(np.float64)
        yield from ((cut, joints) for cut in cuts)
        return
    positions = strided(read_amass(path, models), HUMANML3D.fps).positions
    # (x, y, z) -> (-x, z, y): the published exchange of axes and its flip of x, together a rotation.
    turned = positions[..., [0, 2, 1]] * [-1, 1, 1]
    turned = turned[round(LEAD_IN.get(cuts[0].collection, 0) * HUMANML3D.fps) :]
    yield from ((cut, turned[cut.start : cut.end]) for cut in cuts)


def _make(job: tuple[Sources, str, list[Cut], Path]) -> dict[str, str]:
    """Write the clips of one source and their mirror images; give those that couldn't be made and why."""
    sources, source, cuts, out = job
    cuts = [cut for cut in cuts if not (out / "new_joint_vecs" / f"M{cut.name}.npy").is_file()]
    if not cuts:
        return {}
    path = sources.find(source)
    if path is None:
        return {cut.name: f"no file {source.replace('.npy', '.npz')}" for cut in cuts}
    missing = {}
    try:
        for cut, joints in clip_joints(path, cuts, sources.models):
            try:
                _write_clip(cut.name, joints, out)
            except ValueError as error:
                missing[cut.name] = f"{path}, frames {cut.start} to {cut.end}: {error}"
    except (ValueError, OSError) as error:
        return {cut.name: str(error) for cut in cuts}
    return missing


def _write_clip(name: str, joints: Float[np.ndarray, "t 22 3"], out: Path) -> None:
    """Write the features of a clip; those of the mirror image last, so that its file says both are whole."""
    for title, pose in ((name, joints), (f"M{name}", mirror_joints(joints, HUMANML3D))):
        features = extract(pose, HUMANML3D, target_bone_lengths="skeleton").astype(np.float32)
        _save(out / "new_joint_vecs" / f"{title}.npy", features)


def _save(path: Path, values: np.ndarray) -> None:
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.save(file, values, allow_pickle=False)


def _read_names(lists: Path) -> dict[str, list[str]]:
    """Read the names of the split files, in HumanML3D/ of the repository or beside index.csv."""
    found = {}
    for key in PUBLISHED:
        places = [folder / f"{key}.txt" for folder in (lists / "HumanML3D", lists)]
        file = next((place for place in places if place.is_file()), None)
        if file is None:
            raise FileNotFoundError(f"{places[0]} is missing; --lists is HumanML3D's repository")
        found[key] = read_text(file).split()
    return found


def _texts(lists: Path) -> Path:
    """Find the folder of captions."""
    places = [lists / "HumanML3D" / "texts", lists / "texts"]
    found = next((place for place in places if place.is_dir()), None)
    if found is None:
        raise FileNotFoundError(f"{places[0]} is missing; unpack HumanML3D/texts.zip there")
    return found


def _finish(out: Path, names: dict[str, list[str]], there: set[str], texts: Path, missing: dict[str, str]) -> None:
    """Write captions, lists, statistics of what is there, and what isn't."""
    (out / "texts").mkdir(parents=True, exist_ok=True)
    for name in sorted(there):
        source = texts / f"{name}.txt"
        if source.is_file():
            shutil.copyfile(source, out / "texts" / f"{name}.txt")
    for key in ("all", *SPLITS):
        write_text(out / f"{key}.txt", "".join(f"{name}\n" for name in names[key] if name in there))
    rows = (read_npy(out / "new_joint_vecs" / f"{name}.npy", fix="delete it") for name in names["all"] if name in there)
    statistics = Statistics.compute(rows, HUMANML3D)
    _save(out / "Mean.npy", statistics.mean.astype(np.float32))
    _save(out / "Std.npy", statistics.std.astype(np.float32))
    if missing:
        write_text(out / "missing.txt", "".join(f"{name}: {reason}\n" for name, reason in missing.items()))
    else:
        (out / "missing.txt").unlink(missing_ok=True)
