"""Show what was understood: clips of a corpus, spread over it, as players on one page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from kinema.data.doctor.patient import Patient
from kinema.motion.recovery import recover_joints
from kinema.motion.view.html import save_html
from kinema.types import Motion

MOST = 24
"""Clips on a page: more than two dozen are not looked at, and players are heavy."""


def corpus_sheet(patient: Patient, file: str | Path) -> Path:
    """Write the page of a corpus: clips that are no mirror images, evenly over its splits."""
    own = np.flatnonzero(~np.array(patient.mirrored, dtype=bool))
    if not len(own):
        raise ValueError(f"{patient.name} has no clip to show on {file}")
    chosen = own[np.unique(np.linspace(0, len(own) - 1, min(MOST, len(own))).round().astype(int))]
    shown = [_clip(patient, int(i)) for i in chosen]
    return save_html(shown, file, f"{patient.name}: {len(chosen)} of {len(own)} clips as they were understood")


def clip_sheet(joints: np.ndarray, name: str, skeleton: str, fps: float, file: str | Path) -> Path:
    """Write the page of one clip, whatever is wrong with it."""
    rows = np.zeros((len(joints), 0), dtype=np.float32)
    return save_html([Motion(joints, rows, name, skeleton, fps)], file, name)


def _clip(patient: Patient, index: int) -> Motion:
    rows, skeleton = np.array(patient.rows(index)), patient.skeleton
    said = [caption.text for caption in patient.captions[index]]
    text = f"{patient.names[index]} ({patient.splits[index]}){': ' if said else ''}{said[0] if said else ''}"
    return Motion(recover_joints(torch.from_numpy(rows), skeleton).numpy(), rows, text, skeleton.name, skeleton.fps)
