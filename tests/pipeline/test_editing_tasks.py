"""Test the published editing tasks' slots and slices against each other and against our own ranges of frames."""

from __future__ import annotations

import pytest
import torch

from kinema.pipeline.editing import TASKS, edited_frames, kept_latents, resolve_ranges, task_slices, task_slots
from kinema.types import LatentSpace

SPACE = LatentSpace("continuous", 8, 49, 4)
TOKENS = torch.arange(1, 50)


@pytest.mark.parametrize("task", TASKS)
def test_slices_hold_the_kept_tokens(task):
    kept = task_slots(task, TOKENS).sum(dim=1).tolist()
    encoded = [sum((end - start) // 4 for start, end in task_slices(task, n)) for n in TOKENS.tolist()]
    assert kept == encoded
    assert not task_slots(task, TOKENS)[torch.arange(49)[None] >= TOKENS[:, None]].any()


@pytest.mark.parametrize("task", TASKS)
def test_ranges_of_frames_leave_the_same_tokens_but_in_outpaint(task):
    ours = kept_latents(edited_frames(resolve_ranges(task, (TOKENS * 4).tolist()), 196), SPACE)
    ours &= torch.arange(49)[None] < TOKENS[:, None]
    published = task_slots(task, TOKENS)
    if task != "outpaint":
        assert torch.equal(ours, published)
        return
    assert torch.equal(ours[3::4], published[3::4])  # lengths that are multiples of four tokens
    both = TOKENS >= 3
    earlier = ours[both].int().argmax(dim=1) - published[both].int().argmax(dim=1)
    assert set(earlier.tolist()) == {0, 1}


def test_an_unknown_task_is_named():
    with pytest.raises(ValueError, match="unknown editing task 'middle'; allowed: prefix, suffix, inbetween, outpaint"):
        task_slots("middle", TOKENS)
