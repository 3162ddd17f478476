"""Draw clips of the synthetic corpus as strips of poses: python docs/images/synthetic.py [NUMBER ...]"""

from __future__ import annotations

import sys
from pathlib import Path

import torch

from kinema.data.synthetic import synthetic_clips
from kinema.motion.export import save
from kinema.motion.features import extract
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import HUMANML3D
from kinema.types import Motion

numbers = [int(number) for number in sys.argv[1:]] or [20]
clips = {clip.name: clip for clip in synthetic_clips(size=max(numbers) + 1, seed=0)}
for number in numbers:
    clip = clips[f"synthetic_{number:06d}"]
    features = extract(clip.joints(), HUMANML3D, target_bone_lengths="skeleton")
    joints = recover_joints(torch.from_numpy(features), HUMANML3D).numpy()
    motion = Motion(joints, features, clip.captions[0].caption.text, "humanml3d", HUMANML3D.fps)
    print(save(motion, Path(__file__).with_name(f"{clip.name}.png")))
