"""Map the joints of a capture to a skeleton's: by a data file of names and weights, recognised by the names it has."""

from __future__ import annotations

import re
from collections.abc import Mapping as Dict
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from yaml import safe_load

from kinema.files.yaml import read_yaml
from kinema.motion.skeleton import HUMANML3D, Skeleton

KNOWN = Path(__file__).with_name("mappings")
PREFIX = re.compile(r"(?i)^(.*:|mixamorig\d*_?)")
SHOWN = 12
"""Names of joints that a message lists at most."""


@dataclass(frozen=True)
class JointMapping:
    """Say of which source joints each target joint is the weighted mean.

    `scale` leads to the skeleton's unit (None: found from the body's size); `skip_frames` are a rest pose in front;
    `aliases` are other names of a source joint.
    """

    title: str
    joints: Dict[str, Dict[str, float]]
    scale: float | None = None
    skip_frames: int = 0
    aliases: Dict[str, tuple[str, ...]] = field(default_factory=dict)

    def lacking(self, names: tuple[str, ...]) -> list[str]:
        """List the source joints that a capture of these names doesn't have."""
        there = _plain(names)
        wanted = {source for weights in self.joints.values() for source in weights}
        return sorted(source for source in wanted if not there.keys() & self._spellings(source))

    def lacking_share(self, names: tuple[str, ...]) -> float:
        """Return which share of its source joints a capture of these names doesn't have."""
        return len(self.lacking(names)) / len({source for weights in self.joints.values() for source in weights})

    def weights(self, names: tuple[str, ...], skeleton: Skeleton) -> Float[np.ndarray, "j s"]:
        """Build the matrix that takes source positions to the skeleton's joints, rows summing to one."""
        there, matrix = _plain(names), np.zeros((skeleton.num_joints, len(names)))
        for row, joint in enumerate(skeleton.joint_names):
            for source, share in self.joints[joint].items():
                (spelling,) = sorted(there.keys() & self._spellings(source))[:1]
                matrix[row, there[spelling]] += share
        return matrix

    def _spellings(self, source: str) -> set[str]:
        return {name.lower() for name in (source, *self.aliases.get(source, ()))}


def _plain(names: tuple[str, ...]) -> dict[str, int]:
    """Index names without a prefix (`mixamorig:Hips`, `mixamorig_Hips`, `mixamorig1Hips`), in small letters."""
    return {PREFIX.sub("", name).lower(): i for i, name in reversed(list(enumerate(names)))}


@cache
def known_mappings() -> dict[str, JointMapping]:
    """Read the mappings that come with the package, by name."""
    return {path.stem: read_mapping(path) for path in sorted(KNOWN.glob("*.yaml"))}


def find_mapping(names: tuple[str, ...], source: Path) -> JointMapping:
    """Find the mapping all of whose joints a capture has; raises ValueError that names the nearest one."""
    known = known_mappings()
    fitting = [mapping for mapping in known.values() if not mapping.lacking(names)]
    if fitting:
        return max(fitting, key=lambda mapping: len({s for w in mapping.joints.values() for s in w}))
    nearest, mapping = min(known.items(), key=lambda item: item[1].lacking_share(names))
    lacking = mapping.lacking(names)
    more = ", ..." if len(names) > SHOWN else ""
    raise ValueError(
        f"{source} has joints of no known skeleton ({', '.join(known)}); nearest is {nearest}, which needs "
        f"{', '.join(lacking[:SHOWN])} too. It has {', '.join(names[:SHOWN])}{more}; give a mapping of your own: "
        "--mapping FILE.yaml (docs/own_motion.md)"
    )


def read_mapping(path: str | Path, skeleton: Skeleton = HUMANML3D) -> JointMapping:
    """Read a mapping from YAML: title, joints, scale, skip_frames, aliases; raises ValueError for a wrong one."""
    path = Path(path)
    content: Any = safe_load(read_yaml(path, fix="see docs/own_motion.md"))
    if not isinstance(content, dict) or not isinstance(content.get("joints"), dict):
        raise ValueError(f"{path} is no mapping: it needs `joints:`, a source joint or {{joint: share, ...}} for each")
    unknown = content.keys() - {"title", "joints", "scale", "skip_frames", "aliases"}
    if unknown:
        raise ValueError(
            f"{path}: unknown key {min(unknown, key=str)!r}; known: title, joints, scale, skip_frames, aliases"
        )
    joints = {str(joint): _shares(path, joint, source) for joint, source in content["joints"].items()}
    different = joints.keys() ^ set(skeleton.joint_names)
    if different:
        name = min(different)
        what = "lacks" if name in skeleton.joint_names else "has the unknown"
        raise ValueError(f"{path} {what} joint {name!r}; it needs {', '.join(skeleton.joint_names)}")
    scale, skip = content.get("scale"), content.get("skip_frames", 0)
    if scale is not None and not (isinstance(scale, int | float) and 0 < scale < 1e3):
        raise ValueError(f"{path}: scale={scale} must be a positive number, {skeleton.unit} per unit of the file")
    if not isinstance(skip, int) or isinstance(skip, bool) or skip < 0:
        raise ValueError(f"{path}: skip_frames={skip} must be a whole number from 0 on")
    aliases = {str(k): tuple(map(str, v)) for k, v in (content.get("aliases") or {}).items()}
    return JointMapping(str(content.get("title", path.stem)), joints, scale, skip, aliases)


def _shares(path: Path, joint: Any, source: Any) -> dict[str, float]:
    """Read one joint's sources; shares sum to one."""
    shares = {source: 1.0} if isinstance(source, str) else source
    numbers = isinstance(shares, dict) and all(
        isinstance(v, int | float) and not isinstance(v, bool) for v in shares.values()
    )
    if not numbers or abs(sum(shares.values()) - 1) > 1e-6:
        raise ValueError(f"{path}: {joint}: {source!r} must be a joint's name, or names with shares that sum to 1")
    return {str(name): float(share) for name, share in shares.items()}
