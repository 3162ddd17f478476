"""See a corpus the same way whether it is packed or still a folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from kinema.data.catalog import SPLITS, Catalog, Clip, Dropped, read_joints_folder, read_official
from kinema.data.convert import convert
from kinema.data.folders import instead_of, stems, visible_files
from kinema.data.origin import Origin
from kinema.data.packing import cut_entries
from kinema.data.slips import Slip
from kinema.data.store import PackedStore
from kinema.files.arrays import NUMBERS, Wanted, map_npy
from kinema.motion.convention import AS_IS, Convention
from kinema.motion.shapes import skeleton_of
from kinema.motion.skeleton import Skeleton
from kinema.motion.statistics import Statistics
from kinema.types import Caption


@dataclass
class Patient:
    """Hold a corpus' clips by parallel lists, what was left out of it, and the statistics it brought.

    `rows` gives a clip's full-width features. `known` holds the clip's fields, `origins` the take that it was cut
    from and where, if the corpus says so; `entries` how many entries of a usable length a clip has. `rate` says where
    the rate of a folder's joints is known from, `untold` of which clips it isn't, `convention` what was told of the
    joints, `slips` what is wrong with lines of captions and with the manifest, where they can be read.
    """

    name: str
    skeleton: Skeleton
    names: list[str]
    splits: list[str]
    mirrored: list[bool]
    captions: list[list[Caption]]
    known: list[dict[str, str]]
    rows: Callable[[int], np.ndarray]
    dropped: Sequence[Dropped]
    statistics: Statistics | None
    origins: list[Origin | None]
    entries: list[int]
    untold: list[bool]
    rate: str = ""
    convention: Convention = AS_IS
    slips: Sequence[Slip] = ()

    def __len__(self) -> int:
        return len(self.names)


def from_store(path: Path, index: dict[str, Origin], slips: Sequence[Slip] = ()) -> Patient:
    """See a packed store; what `index` tells of a clip by its unmirrored name comes before what the store does."""
    store = PackedStore.open(path)
    store.verify()
    captions: list[list[Caption]] = [[] for _ in range(store.num_clips)]
    for entry, clip in enumerate(store.entries["clip"]):
        captions[clip] += store.entry_captions(entry)
    names, mirrored = [store.clip_name(i) for i in range(store.num_clips)], store.clips["mirrored"].tolist()
    bases = [name[1:] if swapped else name for name, swapped in zip(names, mirrored, strict=True)]
    return Patient(
        name=store.name,
        skeleton=store.skeleton,
        names=names,
        splits=[SPLITS[i] for i in store.clips["split"]],
        mirrored=mirrored,
        captions=captions,
        known=[{f: store.clip_field(i, f) for f in store.fields} for i in range(store.num_clips)],
        rows=store.clip_frames,
        dropped=[Dropped(**{f.name: d[f.name] for f in fields(Dropped) if f.name in d}) for d in store.dropped],
        statistics=store.statistics,
        origins=[index.get(base) or store.clip_origin(i) for i, base in enumerate(bases)],
        entries=np.bincount(store.entries["clip"], minlength=store.num_clips).tolist(),
        untold=[True] * store.num_clips,
        slips=slips,
    )


def from_folder(path: Path, convention: Convention) -> Patient:
    """See a joints folder or an official one; every clip is loaded once. Raises ValueError or FileNotFoundError."""
    skeleton, official = guess_skeleton(path), (path / "new_joint_vecs").is_dir()
    if official and convention != AS_IS:
        raise ValueError(f"{path} holds features: no option changes their axes, unit, order or rate")
    catalog = read_official(path, skeleton.name) if official else read_joints_folder(path, **convention.of_arrays())
    clips, rows, entries, dropped = _load(catalog, skeleton)
    return Patient(
        name=path.name,
        skeleton=skeleton,
        names=[c.name for c in clips],
        splits=[c.split for c in clips],
        mirrored=[c.mirrored for c in clips],
        captions=[[a.caption for a in c.captions] for c in clips],
        known=[c.fields for c in clips],
        rows=rows.__getitem__,
        dropped=dropped,
        statistics=catalog.statistics,
        origins=[c.origin and c.origin.ending(len(r) + 1) for c, r in zip(clips, rows, strict=True)],
        entries=entries,
        untold=[c.convention.fps is None for c in clips],
        rate=catalog.rate,
        slips=catalog.slips,
        convention=convention,
    )


def guess_skeleton(path: Path) -> Skeleton:
    """Tell the skeleton from the first of a folder's arrays that has one. Raises ValueError naming what they are."""
    folder = path / "new_joint_vecs" if (path / "new_joint_vecs").is_dir() else path / "joints"
    first: Exception | None = None
    for name in stems(folder, ".npy"):
        file = folder / f"{name}.npy"
        try:
            return skeleton_of(map_npy(file, Wanted(NUMBERS)))
        except (ValueError, OSError) as error:
            first = first or ValueError(f"{file}: {error}")
    if first is None:
        odd = [f"{file[:-4]}.npy" for file in visible_files(folder) if file.lower().endswith((".npy", ".npz"))]
        if odd:
            (told,) = instead_of(path, folder.name, odd[:1]).values()
            raise FileNotFoundError(f"{path} has no {folder.name}/*.npy, but {told}")
        raise FileNotFoundError(
            f"{path} has neither new_joint_vecs/*.npy nor joints/*.npy; is it a corpus folder? Captures are prepared "
            "first (kinema prepare --format bvh, amc or amass), and the store is examined"
        )
    raise first


def _load(catalog: Catalog, skeleton: Skeleton) -> tuple[list[Clip], list[np.ndarray], list[int], list[Dropped]]:
    clips, rows, entries, dropped = [], [], [], list(catalog.dropped)
    for clip in catalog.clips:
        made = convert((clip, skeleton.name, False))
        if isinstance(made, Dropped):
            dropped.append(made)
            continue
        kept, filtered = cut_entries(clip, len(made.features), skeleton, skeleton.fps)
        clips.append(clip)
        rows.append(made.features)
        entries.append(len(kept))
        dropped += filtered
    return clips, rows, entries, dropped
