"""Read BVH files: a hierarchy of joints with channels, then one line of numbers a frame.

Any channel order; position channels on any joint (many files have six everywhere): for the root they are added to
its OFFSET, elsewhere they replace it (OPEN_MOCAP). Programs that write the root's place twice, as the OFFSET of a rest
pose that stands on the floor and in its channels (Blender), are told by the body that would float. An End Site becomes
the joint `<parent>_end`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinema.motion.captures.capture import Capture, check_size
from kinema.motion.captures.text import numbers, read_text
from kinema.motion.captures.turning import euler

DEEPEST = 200
"""Joints in a line from the root to a tip that a hierarchy may have."""
CHANNELS = {f"{axis}{kind}": (kind, axis) for axis in "xyz" for kind in ("position", "rotation")}


@dataclass
class _Joint:
    name: str
    parent: int
    offset: list[float]
    channels: list[str]


def read_bvh(path: str | Path) -> Capture:
    """Read a BVH file; raises ValueError that names the file and what is wrong with it."""
    path = Path(path)
    head, found, motion = read_text(path).partition("MOTION")
    if not found or "HIERARCHY" not in head:
        raise ValueError(f"{path} is no BVH file: it has no {'MOTION' if 'HIERARCHY' in head else 'HIERARCHY'} section")
    joints = _Hierarchy(path, head.split("HIERARCHY", 1)[1]).joints
    values, fps = _motion(path, motion, sum(len(joint.channels) for joint in joints))
    check_size(path, len(values), len(joints))
    rotations = np.tile(np.eye(3), (len(values), len(joints), 1, 1))
    rest = np.array([joint.offset for joint in joints])
    translations = np.tile(rest, (len(values), 1, 1))
    column = 0
    for index, joint in enumerate(joints):
        own = values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        kinds = [CHANNELS[channel] for channel in joint.channels]
        _move(translations[:, index], own, kinds, added=joint.parent < 0)
        turns = [i for i, (kind, _) in enumerate(kinds) if kind == "rotation"]
        if turns:
            rotations[:, index] = euler("".join(kinds[i][1] for i in turns), own[:, turns], degrees=True)
    names, parents = tuple(joint.name for joint in joints), tuple(joint.parent for joint in joints)
    capture = Capture(names, parents, rotations, translations, rest, fps)
    return _grounded(capture) if _floats(capture, joints[0].channels) else capture


def _floats(capture: Capture, channels: list[str]) -> bool:
    """Say whether the root's OFFSET counts twice: the rest pose stands on the floor with it, the motion far above."""
    for kind, axis in map(CHANNELS.__getitem__, channels):
        at = "xyz".index(axis)
        up, height = np.sign(capture.rest[0, at]), abs(capture.rest[0, at])
        if kind == "position" and height:
            rest, motion = (float((up * where[..., at]).min()) for where in (capture.rest_positions, capture.positions))
            if abs(rest) < height / 4 and motion > height / 2:
                return True
    return False


def _grounded(capture: Capture) -> Capture:
    translations = capture.translations.copy()
    translations[:, 0] -= capture.rest[0]
    note = "the root's OFFSET, which would lift the body off the floor, taken for its place in the rest pose alone"
    return replace(capture, translations=translations, note=note)


def _move(
    translations: Float[np.ndarray, "t 3"],
    values: Float[np.ndarray, "t c"],
    kinds: list[tuple[str, str]],
    *,
    added: bool,
) -> None:
    """Write the position channels of one joint into its translations."""
    for i, (kind, axis) in enumerate(kinds):
        if kind == "position":
            at = "xyz".index(axis)
            translations[:, at] = values[:, i] + (translations[:, at] if added else 0)


class _Hierarchy:
    """Read the tree of a BVH file, token by token."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.joints = path, list[_Joint]()
        self.tokens = _tokens(text)
        self._expect("ROOT")
        self._joint(self._name(), -1, 1)
        more = next(self.tokens, None)
        if more == "ROOT":
            raise self._wrong("has a second ROOT; write one file per body")
        if more is not None:
            raise self._wrong(f"has {more!r} where the hierarchy should end")
        names = [joint.name for joint in self.joints]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise self._wrong(f"names several joints {twice[0]!r}; give each its own name")

    def _joint(self, name: str, parent: int, depth: int) -> None:
        """Read what stands between a joint's braces, its children included."""
        if depth > DEEPEST:
            raise self._wrong(f"nests more than {DEEPEST} joints: it is no body")
        index = len(self.joints)
        self.joints.append(joint := _Joint(name, parent, [0.0, 0.0, 0.0], []))
        while (word := self._next(name)) != "}":
            if word == "OFFSET":
                joint.offset = [self._number(name) for _ in range(3)]
            elif word == "CHANNELS":
                joint.channels = self._channels(name)
            elif word == "JOINT":
                self._joint(self._name(), index, depth + 1)
            elif word.lower() == "end":
                self._name()
                self._joint(f"{name}_end", index, depth + 1)
            else:
                raise self._wrong(f"has {word!r} in joint {name!r}; known: OFFSET, CHANNELS, JOINT, End Site")

    def _channels(self, name: str) -> list[str]:
        count = self._number(name)
        channels = [self._next(name).lower() for _ in range(int(count))]
        unknown = [channel for channel in channels if channel not in CHANNELS]
        if unknown or len(set(channels)) < len(channels):
            what = f"channel {unknown[0]!r}" if unknown else "a channel twice"
            raise self._wrong(f"has {what} in joint {name!r}; known: {', '.join(CHANNELS)}, each once")
        return channels

    def _name(self) -> str:
        """Read a name, which may hold spaces, and the brace after it."""
        words = []
        while (word := self._next("the hierarchy")) != "{":
            words.append(word)
        return " ".join(words)

    def _number(self, name: str) -> float:
        word = self._next(name)
        try:
            value = float(word)
        except ValueError:
            raise self._wrong(f"has {word!r} in joint {name!r} where a number should be") from None
        if not np.isfinite(value):
            raise self._wrong(f"has {word!r} in joint {name!r}; give a finite number")
        return value

    def _next(self, name: str) -> str:
        word = next(self.tokens, None)
        if word is None:
            raise self._wrong(f"is cut off in {name}: a closing brace is missing")
        return word

    def _expect(self, word: str) -> None:
        found = self._next("the hierarchy")
        if found != word:
            raise self._wrong(f"begins its hierarchy with {found!r}, not with {word}")

    def _wrong(self, what: str) -> ValueError:
        return ValueError(f"{self.path} {what}")


def _tokens(text: str) -> Iterator[str]:
    return iter(text.replace("{", " { ").replace("}", " } ").split())


def _motion(path: Path, text: str, width: int) -> tuple[Float[np.ndarray, "t c"], float]:
    """Read the frames (T, channels) and the rate."""
    head = re.match(r"\s*Frames:\s*(\S+)\s+Frame\s+Time:\s*(\S+)", text)
    if head is None:
        raise ValueError(f"{path} should have `Frames: N` and `Frame Time: seconds` after MOTION")
    count, interval = numbers(path, list(head.groups()), "Frames and Frame Time")
    if not 0.001 <= interval <= 1:
        raise ValueError(f"{path} has Frame Time {head[2]}; expected seconds between frames, from .001 to 1")
    values = numbers(path, text[head.end() :].split(), "the motion")
    if count < 1 or not len(values):
        raise ValueError(f"{path} has no frames")
    if len(values) != count * width:
        raise ValueError(
            f"{path} says {count:.0f} frames of {width} channels, {count * width:.0f} numbers, and holds "
            f"{len(values)}: it is cut off, or its CHANNELS aren't those of its frames"
        )
    return values.reshape(-1, width), 1 / interval
