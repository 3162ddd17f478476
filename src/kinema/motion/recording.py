"""Read one clip from a file of this field: joints or features as .npy, an archive of ours or of one array."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from kinema.files.arrays import NUMBERS, Wanted, read_npy, read_npz
from kinema.files.kinds import describe, head_of, require_file
from kinema.motion.captures import amass
from kinema.motion.captures.capture import Capture
from kinema.motion.captures.mapping import read_mapping
from kinema.motion.captures.reading import READERS, REFUSED, captured_joints, read_capture
from kinema.motion.checks import Problem, check_clip
from kinema.motion.convention import AS_IS, Convention
from kinema.motion.features import extract_every
from kinema.motion.formats.arrays import PARTS, load_npz
from kinema.motion.lifting import lift
from kinema.motion.recovery import recover_joints
from kinema.motion.shapes import is_features, skeleton_of
from kinema.motion.skeleton import HUMANML3D, Skeleton, get_skeleton
from kinema.types import Motion

FIX = "give joints (frames, joints, 3) or features as .npy, an .npz that kinema wrote, .bvh or .amc"
BODY_PARAMETERS = ({"poses", "trans"}, {"root_orient", "pose_body"}, {"body_pose", "global_orient"})
"""Names that archives of SMPL's parameters have: AMASS', SMPL-X', and those of body fits."""
RATES = ("fps", *amass.RATES)
"""Names under which archives hold their frame rate."""


@dataclass(frozen=True)
class Recording:
    """Hold a clip as a file had it, its joints brought to a skeleton's convention; `features` where the file had them.

    `note` says how it was read. `ours` is what kinema wrote; what was generated may be as odd as it likes.
    """

    path: Path
    skeleton: Skeleton
    joints: np.ndarray
    features: np.ndarray | None
    convention: Convention
    note: str
    text: str = ""
    ours: Motion | None = None

    def problems(self) -> list[Problem]:
        """Check the joints."""
        return check_clip(self.joints, self.skeleton, self.skeleton.fps, self.convention)

    def part(self, first: int, end: int) -> Recording:
        """Cut out the frames from `first` to before `end`, at the skeleton's rate."""
        piece = slice(first, end)
        rows = None if self.features is None else self.features[piece]
        kept = None if self.ours is None or self.ours.kept is None else self.ours.kept[piece]
        ours = None if self.ours is None else replace(self.ours, kept=kept)
        note = f"{self.note}; frames {first}:{end} of {len(self.joints)}"
        return replace(self, joints=self.joints[piece], features=rows, ours=ours, note=note)

    def motion(self, skeleton: Skeleton, width: int) -> Motion:
        """Return it with a row of `width` columns for each frame; joints stay where they are.

        Rows that are narrower are completed, those of joints alone extracted with the skeleton's own bone lengths.
        Raises ValueError for another skeleton, and for joints that are no sound clip.
        """
        if self.skeleton is not skeleton:
            raise ValueError(f"{self.path} holds {self.skeleton.name}'s motion, {skeleton.name}'s is needed")
        rows = self.features
        broken = ("shape", "nan", "bone") if rows is not None or self.ours is not None else None
        if fatal := [p for p in self.problems() if p.fatal and (broken is None or p.kind in broken)]:
            raise ValueError(f"{self.path}: {'; '.join(f'{p.message}; fix: {p.fix}' for p in fatal)}")
        if rows is None:
            lengths = None if skeleton.bone_lengths is None else "skeleton"  # as corpora are prepared
            rows = extract_every(self.joints, skeleton, target_bone_lengths=lengths)
        elif rows.shape[1] < width:
            rows = lift(rows, skeleton)
        made = Motion(self.joints, rows, self.text, skeleton.name, skeleton.fps)
        return made if self.ours is None else replace(made, seed=self.ours.seed, kept=self.ours.kept)


def read_recording(path: str | Path, convention: Convention = AS_IS) -> Recording:
    """Read a clip. Raises FileNotFoundError, or ValueError that names the file, what it is and what to do."""
    path = Path(path)
    if path.suffix.lower() in (*READERS, *REFUSED):
        return _captured(path, read_capture(path), convention)
    head = head_of(require_file(path, FIX))
    if head.startswith(b"PK"):
        return _archive(path, convention)
    if not head.startswith(b"\x93NUMPY"):
        raise ValueError(f"{path} {describe(head)}, no motion; {FIX}")
    return _from_array(path, read_npy(path, Wanted(NUMBERS), fix=FIX), convention)


def _captured(path: Path, capture: Capture, told: Convention) -> Recording:
    """Read a capture of another skeleton, whose names say which joint is which."""
    if told.order is not None or told.handed is not None:
        raise ValueError(f"{path}: joints of a capture are known by their names: leave --order and --handed out")
    mapping = None if told.mapping is None else read_mapping(told.mapping)
    joints, understood = captured_joints(capture, path, mapping=mapping, up=told.up, scale=told.scale, fps=told.fps)
    return Recording(path, HUMANML3D, joints.astype(np.float32), None, told, str(understood))


def _from_array(path: Path, array: np.ndarray, told: Convention, text: str = "") -> Recording:
    try:
        skeleton = skeleton_of(array)
        if is_features(array, skeleton):
            return _from_features(path, array, skeleton, told, text)
        joints = told.apply(array, skeleton)
    except ValueError as error:
        raise ValueError(f"{path} holds {array.dtype} {array.shape}: {error}") from None
    first = f", the first {skeleton.num_joints} are read" if array.shape[1] > skeleton.num_joints else ""
    rate = "taken for granted" if told.fps is None else f"resampled to {skeleton.fps:g}"
    note = f"{array.shape[1]} joints{first}; {told.fps or skeleton.fps:g} fps, {rate}"
    return Recording(path, skeleton, joints, None, told, note, text)


def _from_features(path: Path, array: np.ndarray, skeleton: Skeleton, told: Convention, text: str) -> Recording:
    if told not in (AS_IS, Convention(fps=skeleton.fps)):
        raise ValueError(f"features are {skeleton.name}'s, upright and at {skeleton.fps:g} fps: no option changes them")
    rows = np.ascontiguousarray(array, dtype=np.float32)
    joints = recover_joints(torch.from_numpy(rows), skeleton).numpy()
    return Recording(path, skeleton, joints, rows, told, f"features {array.shape}, joints recovered from them", text)


def _archive(path: Path, told: Convention) -> Recording:
    names = _names(path)
    if set(names) >= PARTS:
        motion = load_npz(path)
        skeleton = get_skeleton(motion.skeleton)
        note = f"a motion of {motion.joints.shape[1]} joints with features {motion.features.shape}"
        if told != AS_IS:
            raise ValueError(f"{path} is a motion that kinema wrote: no option changes its convention")
        rows = motion.features if motion.features.shape[1] >= skeleton.essential_width else None
        return Recording(path, skeleton, motion.joints, rows, told, note, motion.text, motion)
    if set(names) >= {"poses", "trans", amass.REST}:
        return _captured(path, amass.read_amass(path), told)
    if any(known <= set(names) for known in BODY_PARAMETERS):
        raise ValueError(f"{path} {_body_parameters(path, names)}")
    numbers = read_npz(path, {name: Wanted(f"{NUMBERS}bUS", optional=True) for name in names}, fix=FIX)
    motions = {n: a for n, a in numbers.items() if a.dtype.kind in NUMBERS and _is_motion(a)}
    if len(motions) != 1 and "joints" not in motions:
        found = ", ".join(f"{n} {a.shape}" for n, a in list(numbers.items())[:12]) or "nothing"
        raise ValueError(f"{path} is no archive of one motion: it has {found}; {FIX}")
    rates = [numbers[name] for name in RATES if name in numbers and numbers[name].dtype.kind in NUMBERS]
    rate = next((float(value.item()) for value in rates if value.size == 1), None)
    array = motions["joints"] if "joints" in motions else next(iter(motions.values()))
    if told.fps or rate is None or array.ndim == 2:
        return _from_array(path, array, told)
    try:
        read = replace(told, fps=rate)
    except ValueError as error:
        raise ValueError(f"{path}: {error}; give --fps") from None
    return _from_array(path, array, read)


def _is_motion(array: np.ndarray) -> bool:
    try:
        skeleton_of(array)
    except ValueError:
        return False
    return True


def _names(path: Path) -> list[str]:
    """Name the arrays of an archive."""
    try:
        with zipfile.ZipFile(path) as archive:
            files = archive.namelist()
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as error:
        raise ValueError(f"{path} is a damaged archive ({error}): copy it again") from None
    if any(name.endswith("data.pkl") for name in files):
        raise ValueError(f"{path} is a file of torch, no motion; {FIX}")
    return [name.removesuffix(".npy") for name in files if name.endswith(".npy")]


def _body_parameters(path: Path, names: list[str]) -> str:
    rate = next((name for name in RATES if name in names), None)
    fps = ""
    if rate is not None:
        value = read_npz(path, {rate: Wanted(NUMBERS)}, fix=FIX)[rate]
        fps = f", then give --fps {float(value.reshape(-1)[0]):g}" if value.size else ""
    return (
        "holds parameters of an SMPL body (poses, not positions), as AMASS does: run its body model (HumanML3D's "
        f"raw_pose_processing, or the smplx package) and save joints[:, :22] as (frames, 22, 3) in an .npy{fps}"
    )
