"""Run every check on a corpus."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from kinema.data.catalog import SPLITS
from kinema.data.doctor import contents, likeness, nearness
from kinema.data.doctor.finding import Finding
from kinema.data.doctor.patient import Patient, from_folder, from_store
from kinema.data.doctor.sheet import clip_sheet, corpus_sheet
from kinema.data.doctor.sketch import sketch
from kinema.data.folders import listed_names, stems
from kinema.data.manifest import read_clip_fields
from kinema.data.origin import read_index
from kinema.data.slips import Slip, find_slips
from kinema.data.store import PackedStore
from kinema.motion.convention import AS_IS, Convention
from kinema.motion.recording import read_recording


def diagnose(
    target: str | Path | PackedStore,
    *,
    source: str | Path | None = None,
    convention: Convention = AS_IS,
    sheet: str | Path | None = None,
) -> list[Finding]:
    """Examine a packed store, a corpus folder (joints or official layout) or one file of motion (.npy, .npz).

    `source` is the folder that a store was made from: its lists and files are then examined too. `index.csv` in the
    folder or beside it tells which clips come from one take; it and the lists are enough for that finding.
    `convention` says how the joints of a folder or file are written; `sheet` is a page to write that shows what was
    understood. Raises FileNotFoundError if there is nothing at
    `target`, or `source` has no split files; ValueError for a convention of a store, whose joints are read already.
    """
    path = target.path if isinstance(target, PackedStore) else Path(target)
    if path.is_file():
        return list(_one_motion(path, convention, sheet))
    if not path.is_dir():
        raise FileNotFoundError(f"{path} is no packed store, corpus folder or file of motion; check the path")
    packed = (path / "manifest.json").is_file() and (path / "features.f32").is_file()
    if packed and convention != AS_IS:
        raise ValueError(f"{path} is a packed store: its joints are read already; prepare it again with these options")
    folder = Path(source) if source is not None else (None if packed else path)
    if source is not None and not any((Path(source) / f"{s}.txt").is_file() for s in SPLITS):
        raise FileNotFoundError(f"source {source} has no train.txt, val.txt or test.txt; pass the corpus folder")
    findings: list[Finding] = []
    try:
        findings += _lists(folder, prepared=packed) if folder is not None else ()
        if packed:
            patient = from_store(path, read_index(folder), _slips(folder)) if folder else from_store(path, {})
        else:
            patient = from_folder(path, convention)
    except (ValueError, FileNotFoundError) as error:
        return [*findings, Finding("error", "unreadable", str(error), "see the message; then examine it again")]
    if sheet is not None:
        corpus_sheet(patient, sheet)
    return findings + list(_examine(patient))


def _examine(patient: Patient) -> Iterator[Finding]:
    yield from contents.counts(patient)
    yield from contents.left_out(patient)
    yield from contents.captions(patient)
    yield from contents.sides(patient)
    yield from contents.statistics(patient)
    if len(patient):
        seen = sketch(patient)
        yield from contents.motion(patient, seen)
        yield from likeness.near_duplicates(patient, seen.poses)
    yield from likeness.leakage(patient)
    yield from nearness.takes(patient.names, patient.splits, patient.mirrored, patient.origins)
    yield from nearness.words(patient)


def _lists(folder: Path, *, prepared: bool) -> Iterator[Finding]:
    """Examine the split files against each other and against the files there are.

    Files that are lacking are told here if a store was `prepared` from the folder; else reading it will tell.
    """
    files = {s: folder / f"{s}.txt" for s in SPLITS}
    listed = {s: listed_names(file) if file.is_file() else [] for s, file in files.items()}
    where: dict[str, list[str]] = defaultdict(list)
    for split, names in listed.items():
        for name in names:
            where[name].append(split)
    repeated = tuple(f"{name} ({', '.join(s)})" for name, s in where.items() if len(s) > 1)
    if repeated:
        message = f"{len(repeated)} clips are listed more than once in train.txt, val.txt and test.txt"
        yield Finding("error", "duplicate names", message, "list every clip once, in one split", repeated)
    motions = next((folder / n for n in ("new_joint_vecs", "joints") if (folder / n).is_dir()), None)
    if motions is None:
        yield from _listed_takes(folder, where)
        return
    present = set(stems(motions, ".npy"))
    lacking = tuple(name for name in where if name not in present)
    if lacking and prepared:
        message = f"{len(lacking)} of {len(where)} listed clips have no file in {motions.name}/ any more"
        fix = "restore them: the store cannot be made again from this folder"
        yield Finding("warning", "missing files", message, fix, lacking)
    unlisted = tuple(sorted(present - set(where)))
    if unlisted:
        message = f"{len(unlisted)} files of {motions.name}/ are in no split"
        yield Finding("info", "unlisted files", message, "add them to a split, if they belong to one", unlisted)


def _slips(folder: Path) -> list[Slip]:
    """Say what is wrong with the captions and the manifest of the folder that a store was made from."""
    lists = [folder / f"{split}.txt" for split in SPLITS]
    clips = {
        *stems(folder / "joints", ".npy"),
        *(name for file in lists if file.is_file() for name in listed_names(file)),
    }
    return [*find_slips(folder), *read_clip_fields(folder).strays(clips)]


def _listed_takes(folder: Path, where: dict[str, list[str]]) -> Iterator[Finding]:
    """Compare the takes of lists without their motions, as the repository of HumanML3D has them."""
    index, mirrored = read_index(folder), [name.startswith("M") and name[1:] in where for name in where]
    origins = [index.get(name[1:] if swapped else name) for name, swapped in zip(where, mirrored, strict=True)]
    yield from nearness.takes(list(where), [splits[0] for splits in where.values()], mirrored, origins)


def _one_motion(file: Path, convention: Convention, sheet: str | Path | None) -> Iterator[Finding]:
    try:
        found = read_recording(file, convention)
    except ValueError as error:
        yield Finding("error", "unreadable", str(error), "see the message; then examine it again")
        return
    length, skeleton = len(found.joints), found.skeleton
    if sheet is not None:
        clip_sheet(found.joints, file.name, skeleton.name, skeleton.fps, sheet)
    seconds = f"{length} frames of {skeleton.name}, {length / skeleton.fps:.1f} s"
    yield Finding("info", "counts", f"{file.name}: {seconds} ({found.note})")
    for problem in found.problems():
        yield Finding("error" if problem.fatal else "warning", problem.kind, problem.message, problem.fix)
