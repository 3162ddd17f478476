"""Read Acclaim captures: a skeleton (ASF) and its motion (AMC).

A bone's turn is R = C M C^T with C from `axis` and M from its degrees of freedom, the later ones from the left
(z after y after x); its end lies at R (direction * length) from its start (OPEN_MOCAP). The joint named like a bone
is the bone's *start*, as BVH conversions of these files have it; the end of a last bone is the joint `<bone>_end`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinema.motion.captures.capture import Capture, check_size
from kinema.motion.captures.text import numbers, read_text
from kinema.motion.captures.turning import euler

AMC_FPS = 120.0
"""The files don't hold their rate; CMU's and HDM05's is 120."""


@dataclass
class _Bone:
    """Hold a bone of the skeleton: the way from its start to its end, its axes and its degrees of freedom."""

    name: str
    way: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))
    axes: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    dof: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Asf:
    bones: dict[str, _Bone]
    parents: dict[str, str]
    degrees: bool


def find_asf(path: Path) -> Path:
    """Find the skeleton of a motion: the ASF beside it whose name its own begins with, or the only one.

    Raises FileNotFoundError if there is none, or several of which none is named like it.
    """
    beside = sorted(p for p in path.parent.iterdir() if p.suffix.lower() == ".asf")
    named = [p for p in beside if path.stem.startswith(p.stem)]
    if named:
        return max(named, key=lambda p: len(p.stem))
    if len(beside) == 1:
        return beside[0]
    found = f"found {', '.join(p.name for p in beside)}" if beside else "there is none"
    raise FileNotFoundError(f"{path} needs its skeleton, an .asf file in the same folder named like its start; {found}")


def read_amc(path: str | Path, asf: str | Path | None = None, *, fps: float = AMC_FPS) -> Capture:
    """Read an AMC file with its skeleton (None: the ASF beside it); raises ValueError that names file and line."""
    path = Path(path)
    text = read_text(path)
    skeleton_path = Path(asf) if asf is not None else find_asf(path)
    skeleton = _read_asf(skeleton_path)
    values = _read_frames(path, text, skeleton)
    degrees = ":RADIANS" not in text.upper().split() and (skeleton.degrees or ":DEGREES" in text.upper().split())
    frames = len(values["root"])
    check_size(path, frames, 2 * len(skeleton.bones))
    order = ["root", *skeleton.parents]
    rotations, translations, rest, names, parents = [], [], [], [], []
    for name in order:
        bone, parent = skeleton.bones[name], skeleton.parents.get(name)
        names.append(name)
        parents.append(-1 if parent is None else order.index(parent))
        before = np.zeros(3) if parent is None else skeleton.bones[parent].way
        rotations.append(_turns(bone, values.get(name, np.zeros((frames, 0))), degrees))
        rest.append(before)
        moved = values["root"][:, [bone.dof.index(d) for d in ("tx", "ty", "tz")]] if parent is None else before
        translations.append(np.broadcast_to(moved, (frames, 3)))
    for name in order:
        if name not in skeleton.parents.values():
            names.append(f"{name}_end")
            parents.append(order.index(name))
            rotations.append(np.tile(np.eye(3), (frames, 1, 1)))
            rest.append(skeleton.bones[name].way)
            translations.append(np.broadcast_to(skeleton.bones[name].way, (frames, 3)))
    return Capture(tuple(names), tuple(parents), np.stack(rotations, 1), np.stack(translations, 1), np.stack(rest), fps)


def _turns(bone: _Bone, values: Float[np.ndarray, "t d"], degrees: bool) -> Float[np.ndarray, "t 3 3"]:
    """Turn a bone by its degrees of freedom about its own axes."""
    turning = [i for i, name in enumerate(bone.dof) if name.startswith("r")]
    # From the left means the last of them is outermost: reversed, it is the first about the own axes.
    axes = "".join(bone.dof[i][1] for i in reversed(turning))
    turned = euler(axes, values[:, turning[::-1]], degrees=degrees)
    return bone.axes @ turned @ bone.axes.T


def _read_asf(path: Path) -> _Asf:
    """Read the skeleton: units, root, bones and which bone hangs on which."""
    sections = _sections(path, read_text(path))
    for needed in ("root", "bonedata", "hierarchy"):
        if needed not in sections:
            raise ValueError(f"{path} is no ASF file: it has no :{needed} section")
    units = {line[0]: line[1] for line in sections.get("units", []) if len(line) > 1}
    degrees = not units.get("angle", "deg").startswith("rad")
    root = {line[0]: line[1:] for line in sections["root"]}
    order = tuple(word.lower() for word in root.get("order", ()))
    if not {"tx", "ty", "tz"} <= set(order):
        raise ValueError(f"{path}: the root's order is {' '.join(order) or 'missing'}; it needs TX TY TZ")
    turn = numbers(path, root.get("orientation", ["0", "0", "0"]), "the root's orientation")
    axis = root.get("axis", ["XYZ"])[0].lower()
    bones = {"root": _Bone("root", axes=_axes(axis, turn, degrees), dof=order)}
    for bone in _bones(path, sections["bonedata"], degrees):
        bones[bone.name] = bone
    parents = {}
    for line in sections["hierarchy"]:
        if line[0] in ("begin", "end"):
            continue
        for child in line[1:]:
            for name in (line[0], child):
                if name not in bones:
                    raise ValueError(f"{path}: the hierarchy names {name!r}, which is no bone of it")
            parents[child] = line[0]
    return _Asf(bones, _from_the_root(path, parents), degrees)


def _axes(order: str, angles: Float[np.ndarray, " 3"], degrees: bool) -> Float[np.ndarray, "3 3"]:
    """Turn by angles in the given order, the later ones from the left."""
    return euler(order[::-1], angles[None, ::-1], degrees=degrees)[0]


def _from_the_root(path: Path, parents: dict[str, str]) -> dict[str, str]:
    """Order bones so that parents come before children."""
    found: dict[str, str] = {}
    while len(found) < len(parents):
        ready = [c for c, p in parents.items() if c not in found and (p == "root" or p in found)]
        if not ready:
            raise ValueError(f"{path}: {min(parents.keys() - found.keys())!r} doesn't hang on the root")
        found |= {child: parents[child] for child in ready}
    return found


def _sections(path: Path, text: str) -> dict[str, list[list[str]]]:
    """Split the file at its `:name` lines; each section is its lines' words, a section's own words first."""
    sections: dict[str, list[list[str]]] = {}
    lines: list[list[str]] = []
    for line in text.splitlines():
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if words[0].startswith(":"):
            lines = sections.setdefault(words[0][1:].lower(), [])
            words = words[1:]
        if words:
            lines.append(words)
    return sections


def _bones(path: Path, lines: list[list[str]], degrees: bool) -> list[_Bone]:
    found: list[_Bone] = []
    fields: dict[str, list[str]] = {}
    for words in lines:
        if words[0] == "begin":
            fields = {}
        elif words[0] == "end":
            found.append(_bone(path, fields, degrees))
        else:
            fields[words[0].lower()] = words[1:]
    return found


def _bone(path: Path, fields: dict[str, list[str]], degrees: bool) -> _Bone:
    name = " ".join(fields.get("name", ()))
    lacking = [key for key in ("name", "direction", "length") if not fields.get(key)]
    if lacking:
        raise ValueError(f"{path}: bone {name!r} has no {lacking[0]}")
    way = numbers(path, fields["direction"][:3], f"the direction of {name!r}")
    length = numbers(path, fields["length"][:1], f"the length of {name!r}")
    axis = fields.get("axis", ["0", "0", "0", "XYZ"])
    if len(way) != 3 or len(axis) != 4 or sorted(axis[3].lower()) != ["x", "y", "z"]:
        raise ValueError(f"{path}: bone {name!r} needs a direction of three numbers and an axis such as `0 0 20 XYZ`")
    turn = numbers(path, axis[:3], f"the axis of {name!r}")
    dof = tuple(word.lower() for word in fields.get("dof", ()))
    unknown = [d for d in dof if d not in ("rx", "ry", "rz")]
    if unknown:
        raise ValueError(f"{path}: bone {name!r} has the degree of freedom {unknown[0]!r}; rx, ry and rz are read")
    return _Bone(name, way * length[0], _axes(axis[3].lower(), turn, degrees), dof)


def _read_frames(path: Path, text: str, skeleton: _Asf) -> dict[str, Float[np.ndarray, "t d"]]:
    """Read every bone's values by frame."""
    found: dict[str, list[list[str]]] = {name: [] for name, bone in skeleton.bones.items() if bone.dof}
    frames = 0
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith(("#", ":")):
            continue
        if len(words) == 1 and words[0].isdigit():
            _complete(path, found, frames)
            frames += 1
        elif words[0] not in found:
            raise ValueError(f"{path}, line {number}: {words[0]!r} is no moving bone of the skeleton; another .asf?")
        elif frames == 0 or len(found[words[0]]) >= frames:
            raise ValueError(f"{path}, line {number}: {words[0]!r} stands twice in frame {frames}, or before the first")
        elif len(words) - 1 != len(skeleton.bones[words[0]].dof):
            wanted = len(skeleton.bones[words[0]].dof)
            raise ValueError(
                f"{path}, line {number}: {words[0]!r} has {len(words) - 1} values; the skeleton has {wanted}"
            )
        else:
            found[words[0]].append(words[1:])
    if frames == 0:
        raise ValueError(f"{path} has no frames")
    _complete(path, found, frames)
    return {
        name: numbers(path, [w for row in rows for w in row], f"bone {name!r}").reshape(frames, -1)
        for name, rows in found.items()
    }


def _complete(path: Path, found: dict[str, list[list[str]]], frames: int) -> None:
    """Check that the frame that ends here has all bones."""
    lacking = [name for name, rows in found.items() if len(rows) < frames]
    if lacking:
        raise ValueError(
            f"{path}: frame {frames} lacks {', '.join(lacking[:3])}; the file is cut off, or of another .asf"
        )
