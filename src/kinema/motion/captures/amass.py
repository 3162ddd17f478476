"""Read AMASS archives: poses of SMPL-H or SMPL-X bodies, whose joints come from the user's own body-model file.

An archive that kinema wrote (`motion.formats.amass`) brings its own body's joints, and needs no model.

The pelvis is at its place in the shaped body plus `trans`. Poses are axis-angle, the body's 22 joints first; Z is up.
Bodies breathe with their soft-tissue coefficients (`dmpls`) where the user has these too (HUMANML3D_DATA §2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from kinema.files.arrays import NUMBERS, Wanted, read_npz
from kinema.motion.captures.capture import Capture
from kinema.motion.captures.mapping import known_mappings
from kinema.motion.convention import AXES
from kinema.motion.skeleton import HUMANML3D

BODY = 22
"""Joints of the body, in HumanML3D's order; hands and face follow."""
SHAPES, SOFT = 10, 8
"""Coefficients that are read of the shape and of the soft tissue, as HumanML3D does."""
RATES = ("mocap_framerate", "mocap_frame_rate")
REST, UP = "rest_joints", "up_axis"
"""Names that kinema's archives have beyond AMASS' own: joints at rest (22, 3), Y up; the world's upward axis."""


@dataclass(frozen=True, eq=False)
class BodyModel:
    """Hold what places a body's joints: at rest, by shape coefficient and by soft-tissue coefficient (none: stiff)."""

    rest: Float[np.ndarray, "22 3"]
    shape: Float[np.ndarray, "22 3 s"]
    soft: Float[np.ndarray, "22 3 d"]

    def joints(self, betas: Float[np.ndarray, " s"], dmpls: Float[np.ndarray, "t d"]) -> Float[np.ndarray, "t 22 3"]:
        """Place the joints of an unposed body, frame by frame."""
        return self.rest + self.shape @ betas + np.einsum("jcd,td->tjc", self.soft, dmpls)


def read_body_model(path: Path, soft: Path | None = None) -> BodyModel:
    """Read a model.npz of SMPL-H or SMPL-X, and of its soft tissue; raises ValueError naming what it lacks."""
    model = _arrays(path, ("J_regressor", "v_template", "shapedirs"), "a body model (model.npz)")
    regressor = model["J_regressor"][:BODY].astype(np.float64)
    template, shapes = model["v_template"].astype(np.float64), model["shapedirs"].astype(np.float64)
    if regressor.ndim != 2 or template.shape != (regressor.shape[1], 3) or shapes.shape[:2] != template.shape:
        raise ValueError(
            f"{path} is no body model: J_regressor {regressor.shape}, v_template {template.shape} and shapedirs "
            f"{shapes.shape} don't fit each other"
        )
    moves = np.zeros((BODY, 3, 0))
    if soft is not None:
        found = _arrays(soft, ("eigvec",), "a soft-tissue model (model.npz of DMPL)")["eigvec"].astype(np.float64)
        if found.shape[:2] != template.shape:
            raise ValueError(f"{soft}: eigvec {found.shape} doesn't fit the body model's {template.shape[0]} vertices")
        moves = np.einsum("jv,vcd->jcd", regressor, found[..., :SOFT])
    return BodyModel(regressor @ template, np.einsum("jv,vcs->jcs", regressor, shapes[..., :SHAPES]), moves)


@dataclass(frozen=True)
class BodyModels:
    """Find body models in the user's folder: `smplh/male/model.npz`, `smplh/female/model.npz`, `dmpls/...` alike."""

    folder: Path
    soft: Path | None = None

    @cached_property
    def by_gender(self) -> Mapping[str, BodyModel]:
        """Both models; a body of no or unknown gender is taken for female, as HumanML3D does."""
        return {gender: self._model(gender) for gender in ("male", "female")}

    def _model(self, gender: str) -> BodyModel:
        place = self.folder / gender / "model.npz"
        if not place.is_file():
            raise FileNotFoundError(
                f"AMASS needs the body models: {place} is missing (SMPL-H for AMASS, from mano.is.tue.mpg.de, "
                "registration and licence are the user's own)"
            )
        return read_body_model(place, None if self.soft is None else self.soft / gender / "model.npz")


def read_amass(path: str | Path, models: BodyModels | None = None) -> Capture:
    """Read an AMASS archive as a capture of the 22 joints, named as the skeleton names them.

    Raises ValueError for one that is broken, or that needs body models where there are none.
    """
    path = Path(path)
    archive = _arrays(path, ("poses", "trans"), "an AMASS archive")
    poses, trans = archive["poses"].astype(np.float64), archive["trans"].astype(np.float64)
    rate = next((float(archive[key]) for key in RATES if key in archive), None)
    if rate is None or not 1 <= rate <= 1000:
        raise ValueError(f"{path} has no frame rate ({' or '.join(RATES)}), or none from 1 to 1000; it has {rate}")
    if poses.ndim != 2 or poses.shape[1] < 3 * BODY or trans.shape != (len(poses), 3) or not len(poses):
        raise ValueError(f"{path}: poses {poses.shape} and trans {trans.shape} should be (T, 66 or more) and (T, 3)")
    model = _body(path, archive, models)
    betas = _padded(archive.get("betas", np.zeros(0)), model.shape.shape[2])
    soft = archive.get("dmpls", np.zeros((len(poses), 0))).astype(np.float64)
    size = model.soft.shape[2]
    soft = np.pad(soft, ((0, 0), (0, max(0, size - soft.shape[1]))))[:, :size]
    for name, values in (("poses", poses), ("trans", trans), ("betas", betas), ("dmpls", soft), (REST, model.rest)):
        if not np.isfinite(values).all():
            raise ValueError(f"{path} has NaN or infinite {name}")
    return _posed(model.joints(betas, soft), poses, trans, rate, _up(path, archive))


def _body(path: Path, archive: Mapping[str, np.ndarray], models: BodyModels | None) -> BodyModel:
    """Take the archive's own joints at rest, or find the body model of its gender."""
    if REST in archive:
        return BodyModel(archive[REST].astype(np.float64), np.zeros((BODY, 3, 0)), np.zeros((BODY, 3, 0)))
    if models is None:
        raise ValueError(f"{path}: AMASS holds poses of a body model; say where it is (--smplh FOLDER)")
    gender = str(archive["gender"].item()) if "gender" in archive and archive["gender"].size == 1 else ""
    return models.by_gender["male" if gender.strip("b'\"") == "male" else "female"]


def _up(path: Path, archive: Mapping[str, np.ndarray]) -> str | None:
    """Read which axis an archive says is up; AMASS' own say nothing."""
    if UP not in archive:
        return None
    said = str(archive[UP].item())
    if said not in AXES:
        raise ValueError(f"{path} says {UP}={said!r}; allowed: {', '.join(AXES)}")
    return said


def _padded(values: np.ndarray, size: int) -> Float[np.ndarray, " s"]:
    """Take the first coefficients; those that a file doesn't have are zero."""
    found = np.zeros(size)
    kept = values.reshape(-1)[:size]
    found[: len(kept)] = kept
    return found


def _posed(
    joints: Float[np.ndarray, "t 22 3"],
    poses: Float[np.ndarray, "t p"],
    trans: Float[np.ndarray, "t 3"],
    rate: float,
    up: str | None,
) -> Capture:
    parents = HUMANML3D.parents
    offsets = joints - joints[:, [max(parent, 0) for parent in parents]]
    offsets[:, 0] = joints[:, 0]
    moved = offsets.copy()
    moved[:, 0] += trans
    rotations = Rotation.from_rotvec(poses[:, : 3 * BODY].reshape(-1, 3)).as_matrix().reshape(len(poses), BODY, 3, 3)
    smpl = known_mappings()["smpl"].joints
    names = tuple(next(iter(smpl[name])) for name in HUMANML3D.joint_names)
    return Capture(names, parents, rotations, moved, offsets[0], rate, up)


def strided(capture: Capture, fps: float) -> Capture:
    """Keep every int(rate / fps)-th frame, and call that `fps`: 250 becomes 20.83 (HUMANML3D_DATA §2.2)."""
    step = max(int(capture.fps / fps), 1)
    rotations, translations = capture.rotations[::step], capture.translations[::step]
    return replace(capture, rotations=rotations, translations=translations, fps=fps)


def _arrays(path: Path, needed: tuple[str, ...], what: str) -> dict[str, np.ndarray]:
    """Read the arrays of an archive that are asked for."""
    others = (*RATES, "gender", "betas", "dmpls")
    wanted = {name: Wanted() for name in needed} | {name: Wanted(f"{NUMBERS}US", optional=True) for name in others}
    wanted |= {REST: Wanted(NUMBERS, (BODY, 3), optional=True), UP: Wanted("U", (), optional=True)}
    return read_npz(path, wanted, fix=f"give {what}, as its owners publish it")
