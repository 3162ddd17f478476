"""Read corpora into clips, and say of everything that was left out why (HUMANML3D_DATA §7)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kinema.data.captions import AnnotatedCaption
from kinema.data.folders import instead_of, listed_names, stems
from kinema.data.manifest import Manifest, read_clip_fields
from kinema.data.origin import SOURCE_FIELDS, Origin, named_origin, read_index
from kinema.data.slips import UNREADABLE, Slip, check_readable, read_captions
from kinema.files.arrays import NUMBERS, Wanted, read_npy
from kinema.motion.convention import AS_IS, Convention
from kinema.motion.skeleton import get_skeleton
from kinema.motion.statistics import Statistics

VERSION = 4
"""Raised when a reader gives other clips of the same source."""

SPLITS = ("train", "val", "test")
UNTOLD = "taken for granted: no option (fps) and no file tells it"


@dataclass(frozen=True)
class Clip:
    """Hold one clip: its captions, and a callable that loads its motion, so that a corpus need not sit in memory.

    Exactly one of `joints` (-> (T, J, 3), Y up, in the skeleton's unit and frame rate unless `convention` says another)
    and `features` (-> (T, D) full width) is given; it must be picklable (a `functools.partial` of a module's function)
    to be loaded by processes.
    `fields` holds what is known of the clip, e.g. source, label, licence; `origin` its take and frames there.
    `made_from` names all that joints are computed from (a capture's files, a seed) where they are not read as they are.
    """

    name: str
    split: str
    captions: list[AnnotatedCaption] = field(default_factory=list)
    fields: dict[str, str] = field(default_factory=dict)
    joints: Callable[[], np.ndarray] | None = None
    features: Callable[[], np.ndarray] | None = None
    mirrored: bool = False
    origin: Origin | None = None
    convention: Convention = AS_IS
    made_from: str = ""

    def __post_init__(self) -> None:
        if self.split not in SPLITS:
            raise ValueError(f"clip {self.name!r}: split {self.split!r} is not one of {SPLITS}")
        if (self.joints is None) == (self.features is None):
            raise ValueError(f"clip {self.name!r}: give either a `joints` or a `features` loader")


@dataclass(frozen=True)
class Dropped:
    """Say what was left out and why.

    `what`: "missing" (a listed clip without its files), "clip" (unusable motion), "entry" (outside the length filter,
    its windows are kept) or "caption" (unreadable line). `kind` and `fix` are those of an unusable motion's problem.
    """

    name: str
    split: str
    what: Literal["missing", "clip", "entry", "caption"]
    reason: str
    kind: str = ""
    fix: str = ""


@dataclass(frozen=True)
class Catalog:
    """Hold the clips of a corpus in split order, what was dropped on the way, and the statistics it ships with.

    `rate` says where the frame rate of its joints is known from, `slips` what is wrong with lines of captions and with
    the manifest.
    """

    clips: list[Clip]
    dropped: list[Dropped] = field(default_factory=list)
    statistics: Statistics | None = None
    rate: str = ""
    slips: list[Slip] = field(default_factory=list)

    def __iter__(self) -> Iterator[Clip]:
        return iter(self.clips)

    def __len__(self) -> int:
        return len(self.clips)


def read_joints_folder(
    path: str | Path,
    split: str | None = None,
    *,
    up: str | None = None,
    handed: str | None = None,
    scale: Any = None,
    order: str | None = None,
    fps: Any = None,
) -> Catalog:
    """Read `joints/NAME.npy` (T, J, 3), `texts/NAME.txt` and the split files: the layout of open-mocap.

    `texts/` may be absent (a corpus without captions). An optional `manifest.json`, a list of objects with a `name`,
    gives every clip's fields, `fps` among them; `split` names a folder in there with other split files. A clip `MNAME`
    beside `NAME` is taken for the mirror image of it, `NAME_sK` for the K-th piece of a take, unless an `index.csv`
    says otherwise. The other options say how the joints are written (`Convention`); `fps` comes before the manifest's.
    """
    told, manifest = Convention(up, handed, scale, order, fps), read_clip_fields(Path(path))
    catalog = _read_folder(Path(path), "joints", manifest, split)
    if fps is not None:
        return replace(catalog, clips=[replace(c, convention=told) for c in catalog], rate=f"{fps:g} fps, asked for")
    clips = [replace(c, convention=replace(told, fps=manifest.fps(c.name))) for c in catalog]
    return replace(catalog, clips=clips, rate=_told_rate([c.convention.fps for c in clips]))


def _told_rate(rates: list[float | None]) -> str:
    """Say which rates a manifest tells, and of how many clips if not of all."""
    told = [rate for rate in rates if rate is not None]
    if not told:
        return UNTOLD
    which, untold = ", ".join(f"{rate:g}" for rate in sorted(set(told))), len(rates) - len(told)
    if not untold:
        return f"{which} fps, as manifest.json says"
    some = f"{which} fps for {len(told)} of {len(rates)} clips, as manifest.json says"
    return f"{some}; that of the {untold} others is {UNTOLD}"


def read_official(path: str | Path, skeleton: str = "humanml3d") -> Catalog:
    """Read the folders of HumanML3D or KIT-ML: `new_joint_vecs/`, `texts/`, split files, `Mean.npy` and `Std.npy`.

    Mirrored clips are in there under `MNAME`, with their captions swapped already. The folder's own statistics are
    used where present, and `index.csv`, there or beside it, for the takes that clips were cut from. Raises ValueError
    if the statistics do not have the skeleton's full width.
    """
    root, width = Path(path), get_skeleton(skeleton).feature_width
    catalog = _read_folder(root, "new_joint_vecs", Manifest())
    present = [name for name in ("Mean.npy", "Std.npy") if (root / name).is_file()]
    if not present:
        return catalog
    if len(present) == 1:
        raise FileNotFoundError(f"{root} has {present[0]} but not its twin; add it, or remove both to compute them")
    statistics = Statistics.load(root)
    if len(statistics.mean) != width:
        raise ValueError(
            f"{root}/Mean.npy is {len(statistics.mean)} wide, {skeleton} has {width}; is this the folder of the other "
            "corpus (pass skeleton='kit' or 'humanml3d'), or Mean.npy of the essential dims? Remove it to compute it"
        )
    return replace(catalog, statistics=statistics)


def _read_folder(root: Path, motions: str, manifest: Manifest, split: str | None = None) -> Catalog:
    """Read every clip that a split file lists; `motions` names the folder of arrays and so the kind of motion."""
    kind = "joints" if motions == "joints" else "features"
    listed, index = _read_splits(root, motions, split), read_index(root)
    available = set(stems(root / motions, ".npy"))
    texts = set(stems(root / "texts", ".txt")) if (root / "texts").is_dir() else None
    there = instead_of(root, motions, [f"{name}.npy" for name in listed if name not in available])
    there |= instead_of(root, "texts", [f"{name}.txt" for name in listed if texts is not None and name not in texts])
    clips, dropped, slips = [], [], list[Slip]()
    for name, split in listed.items():
        lacking = [f"{motions}/{name}.npy"] if name not in available else []
        lacking += [f"texts/{name}.txt"] if texts is not None and name not in texts else []
        if lacking:
            found = "".join(f", but {there[file]}" for file in lacking if file in there)
            dropped.append(Dropped(name, split, "missing", f"{' and '.join(lacking)} not found{found}"))
            continue
        captions, wrong = ([], []) if texts is None else read_captions(root, f"texts/{name}.txt")
        slips += wrong
        dropped += [Dropped(name, split, "caption", str(slip)) for slip in wrong if slip.flaw is UNREADABLE]
        load: dict[str, Any] = {kind: partial(load_array, str(root / motions / f"{name}.npy"))}
        mirrored = name.startswith("M") and name[1:] in listed
        base, fields = name[1:] if mirrored else name, manifest.of(name)
        named = kind == "joints" and not any(fields.get(field) for field in SOURCE_FIELDS)
        origin = index.get(base) or (named_origin(base) if named else None)
        clips.append(Clip(name, split, captions, fields, mirrored=mirrored, origin=origin, **load))
    slips += manifest.strays(available | set(listed))
    check_readable(root, slips, sum(len(clip.captions) for clip in clips))
    return Catalog(clips, dropped, slips=slips)


def load_array(file: str) -> np.ndarray:
    """Load a .npy file of numbers; one that would execute code, or is cut off, raises ValueError."""
    return read_npy(file, Wanted(NUMBERS), fix="copy it again, or take the clip off the lists")


def _read_splits(root: Path, motions: str, split: str | None = None) -> dict[str, str]:
    """Map every listed name to its split, in split order. Raises FileNotFoundError for what the layout lacks."""
    lists = root / split if split else root
    layout = f"{motions}/NAME.npy, texts/NAME.txt, train.txt, val.txt, test.txt (one NAME a line)"
    lacking = [motions] if not (root / motions).is_dir() else []
    lacking += [str((lists / f"{s}.txt").relative_to(root)) for s in SPLITS if not (lists / f"{s}.txt").is_file()]
    if lacking:
        state = "does not exist" if not root.is_dir() else f"lacks {', '.join(lacking)}"
        raise FileNotFoundError(f"corpus folder {root} {state}; expected layout: {layout}")
    found: dict[str, str] = {}
    for part in SPLITS:
        for name in listed_names(lists / f"{part}.txt"):
            if name in found:
                where = f"twice in {part}.txt" if found[name] == part else f"in {found[name]}.txt and {part}.txt"
                raise ValueError(f"{lists}: clip {name!r} is listed {where}; list it once")
            found[name] = part
    if not found:
        raise ValueError(f"{lists}: train.txt, val.txt and test.txt are all empty; list one clip name a line")
    return found
