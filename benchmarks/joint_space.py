"""Measure what frames of absolute joints cost real motion: rows to joints and back, in millimetres and in columns.

    python benchmarks/joint_space.py [--store stores/open_mocap-...] [--split test] [--statistics shared_axis]

Whole clips, and the crops that training and the protocol cut, go through the tokenizer `joints`. Errors of columns are
root mean squares of normalised ones; those of the yaw's velocity are told for row 0 and for the others too.
"""

from __future__ import annotations

import argparse
import os
import tempfile

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch

from kinema.data.datasets import ClipDataset
from kinema.data.prepare import prepare_store
from kinema.data.store import PackedStore
from kinema.motion.recovery import recover_joints
from kinema.motion.representation import Representation
from kinema.tokenizers.joints import Joints
from kinema.types import MotionBatch


def measured(model: Joints, clips: list[np.ndarray]) -> dict[str, float]:
    """Send clips through, one by one."""
    form, skeleton = model.representation, model.representation.skeleton
    away, errors = [], []
    for clip in clips:
        rows = torch.from_numpy(clip[:, : form.width].copy())[None]
        batch = MotionBatch(rows, torch.tensor([rows.shape[1]]))
        decoded = model.decode(model.encode(batch))
        joints = [recover_joints(one.features, skeleton) for one in (batch, decoded)]
        away.append((joints[0] - joints[1]).norm(dim=-1).flatten() * skeleton.meters * 1000)
        errors.append((form.normalize(batch.features) - form.normalize(decoded.features))[0].square())
    together, millimetres = torch.cat(errors), torch.cat(away)
    found = {"joints mm": millimetres.mean().item(), "most mm": millimetres.max().item()}
    found |= {name: together[:, columns].mean().sqrt().item() for name, columns in form.groups.items()}
    found["root_yaw row 0"] = torch.stack([e[0, 0] for e in errors]).mean().sqrt().item()
    found["root_yaw others"] = torch.cat([e[1:, 0] for e in errors]).mean().sqrt().item()
    return found


def main() -> None:
    """Open or make the corpus, and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", help="a packed corpus (default: a synthetic one)")
    parser.add_argument("--split", default="test")
    parser.add_argument("--statistics", default="shared_axis", help="shared_axis or per_joint")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        made = arguments.store or prepare_store("synthetic", None, folder, name="synthetic", size=64, seed=0)
        tell(PackedStore.open(made), arguments)


def tell(store: PackedStore, arguments: argparse.Namespace) -> None:
    """Print the errors of whole clips and of crops."""
    form = Representation("essential", store.skeleton.name).fit(store.statistics)
    model = Joints(form, statistics=arguments.statistics)
    model.prepare(store.clip_frames(int(clip)) for clip in store.split_clips("train"))
    data = ClipDataset(store, arguments.split)
    kinds = {
        "clips": [store.frames_of(int(entry)) for entry in data.entries],
        "crops": [data[i, i].features for i in range(len(data))],
    }
    for name, clips in kinds.items():
        print(f"{name:6}", "  ".join(f"{key} {value:.4f}" for key, value in measured(model, clips).items()))


if __name__ == "__main__":
    main()
