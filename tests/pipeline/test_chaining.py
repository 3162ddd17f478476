from __future__ import annotations

import torch

from kinema.pipeline.chaining import bridges
from kinema.types import Latents, LatentSpace


def test_a_window_holds_the_end_of_one_part_and_the_start_of_the_next():
    parts = Latents(torch.tensor([6, 4]), torch.tensor([24, 16]), values=torch.arange(12.0).view(2, 6, 1))
    window = bridges(parts, LatentSpace("continuous", 1, 20, 4), transition=8, most=20)
    assert window.latents.values[0, :, 0].tolist() == [3, 4, 5, 0, 0, 6, 7]
    assert window.mask[0].tolist() == [True] * 3 + [False] * 2 + [True] * 2
