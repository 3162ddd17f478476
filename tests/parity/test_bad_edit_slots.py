"""Compare the editing tasks' kept slots and encoded slices with the published evaluation, for all lengths."""

from __future__ import annotations

import pytest
import torch
from safetensors.torch import load_file

from kinema.pipeline.editing import TASKS, task_slices, task_slots

PUBLISHED = {"inbetween": "inbetween", "outpaint": "outpainting", "prefix": "prefix", "suffix": "suffix"}


@pytest.mark.parametrize("task", TASKS)
def test_kept_slots_and_encoded_slices(golden_file, task):
    golden = load_file(golden_file("vq/bad_edit_slots.safetensors"))
    tokens, name = golden["in.frames"] // 4, PUBLISHED[task]
    assert torch.equal(task_slots(task, tokens, 50), golden[f"{name}.out.kept_slots"])
    slices = [[*task_slices(task, n), (0, 0)][:2] for n in tokens.tolist()]
    assert torch.equal(torch.tensor(slices), golden[f"{name}.out.encoded_frame_slices"])
