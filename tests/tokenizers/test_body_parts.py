"""A part's token reads its own chain of each frame, on both skeletons and both representations."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.experiments.config import compose, plain
from kinema.motion.representation import Representation
from kinema.motion.skeleton import HUMANML3D, KIT, get_skeleton
from kinema.motion.statistics import Statistics
from kinema.nn.transformer import run
from kinema.runs.build import build
from kinema.tokenizers import MotionTokenizer
from kinema.tokenizers.body_parts import BodyPartEncoder, part_mask
from kinema.tokenizers.vq import VQVAE
from kinema.types import MotionBatch

KINDS = [(kind, skeleton) for kind in ("essential", "redundant") for skeleton in ("humanml3d", "kit")]


def make(kind="redundant", skeleton="humanml3d", **options) -> BodyPartEncoder:
    torch.manual_seed(0)
    sizes = {"node_width": 8, "node_hidden": 16, "part_width": 8, "feedforward": 16, "heads": 2, "width": 16}
    return BodyPartEncoder(skeleton, kind, code_dim=12, **sizes | options).eval()


def rows(model: BodyPartEncoder, *size: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*size, model.input_dim, generator=torch.Generator().manual_seed(seed))


def columns_of(model: BodyPartEncoder, joint: int) -> list[int]:
    """List the columns that belong to a joint other than the root."""
    groups, found = model.groups, []
    for name, size, first in (("joints", 3, 1), ("rotations", 6, 1), ("velocities", 3, 0)):
        if name in groups:
            start = groups[name].start + size * (joint - first)
            found += range(start, start + size)
    return found


@pytest.mark.parametrize(("kind", "skeleton"), KINDS)
def test_every_column_enters_one_node(kind, skeleton):
    model = make(kind, skeleton)
    x, joints = rows(model, 1, 1), get_skeleton(skeleton).num_joints
    before = model.nodes(x)[0, 0]
    assert before.shape == (joints + (kind == "redundant"), 8)
    owners = {column: joint for joint in range(1, joints) for column in columns_of(model, joint)}
    for column in range(model.input_dim):
        other = x.clone()
        other[..., column] += 1
        changed = (model.nodes(other)[0, 0] != before).any(-1).nonzero().flatten().tolist()
        contact = kind == "redundant" and column >= model.input_dim - 4
        assert changed == [joints if contact else owners.get(column, 0)]


@pytest.mark.parametrize(("kind", "skeleton"), KINDS)
def test_a_part_reads_its_own_chain_the_root_and_the_contacts(kind, skeleton):
    model, body = make(kind, skeleton, layers=1), get_skeleton(skeleton)
    x = rows(model, 2, 3)
    before = model.part_tokens(x)
    for joint in range(1, body.num_joints):
        other = x.clone()
        other[..., columns_of(model, joint)] += 1
        equal = (model.part_tokens(other) == before).all(-1).all(0).all(0)
        assert equal.tolist() == [joint not in chain for chain in body.chains]
    for columns in (range(4), range(model.input_dim - 4, model.input_dim))[: 1 + (kind == "redundant")]:
        other = x.clone()
        other[..., columns] += 1
        assert (model.part_tokens(other) != before).any(-1).all()


def test_frames_are_read_one_by_one():
    model = make()
    x = rows(model, 2, 6)
    before = model.part_tokens(x)
    x[0, 3] += 1
    changed = (model.part_tokens(x) != before).any(-1).any(-1)
    assert changed.nonzero().tolist() == [[0, 3]]


@pytest.mark.parametrize(("skeleton", "parts"), [(HUMANML3D, (3, 4)), (KIT, (0, 1))])
def test_the_contacts_count_to_the_published_chains(skeleton, parts):
    mask = part_mask(skeleton, contacts=True)
    seen = mask[-1, 5:-1].nonzero().flatten().tolist()
    assert seen == sorted({0}.union(*(skeleton.chains[p] for p in parts)))
    assert mask[:, 5].all()
    assert mask[:, -1].all()
    assert mask[:, :5].int().tolist() == torch.eye(len(mask), 5).int().tolist()
    assert torch.equal(part_mask(skeleton, contacts=False), mask[:-1, :-1])


def test_the_last_block_leaves_out_only_what_nobody_reads():
    model = make(layers=3)
    x, seen = rows(model, 2, 4), []
    model.blocks[0].register_forward_pre_hook(lambda _, args: seen.append(args[0]))
    parts = model.part_tokens(x)
    everything = run(model.blocks, seen[0], model.mask[None])
    torch.testing.assert_close(parts.flatten(0, 1), everything[:, :5], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("kind", "skeleton"), KINDS)
def test_padding_and_neighbours_change_nothing(kind, skeleton):
    model, lengths = make(kind, skeleton), torch.tensor([24, 13, 8])
    x = rows(model, 3, 24)
    encoded = model(x, lengths)
    assert encoded.shape == (3, 6, 12)
    for i, length in enumerate(lengths.tolist()):
        alone = model(x[i : i + 1, :length])
        torch.testing.assert_close(encoded[i, : length // 4], alone[0], rtol=1e-5, atol=1e-5)
        assert not encoded[i, length // 4 :].any()


@pytest.mark.parametrize(("kind", "auxiliary"), [("essential", "joints"), ("redundant", "velocities")])
def test_every_weight_of_the_tokenizer_learns(kind, auxiliary):
    encoder = make(kind)
    representation = Representation(kind, "humanml3d").fit(Statistics(np.zeros(263), np.ones(263)))
    model = VQVAE(representation, codebook_size=16, code_dim=12, encoder=encoder, width=16, auxiliary=auxiliary).train()
    assert isinstance(model, MotionTokenizer)
    motion = MotionBatch(torch.randn(4, 32, 263, generator=torch.Generator().manual_seed(1)), torch.full((4,), 32))
    model.loss(motion, generator=torch.Generator().manual_seed(0))["loss"].backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


@pytest.mark.parametrize("representation", ["essential", "redundant", "published"])
@pytest.mark.parametrize("data", ["synthetic", "synthetic_kit"])
def test_the_config_builds_for_every_representation(representation, data):
    cfg = compose(["stage=tokenizer", "tokenizer=vq_attt2m", f"representation={representation}", f"data={data}"])
    model = build(plain(cfg.tokenizer.model))
    assert model.encoder.input_dim == model.representation.width
    assert model.auxiliary == ("joints" if representation == "essential" else "velocities")
    assert model.quantizer.reset == "always"


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="features have 67 columns, this encoder reads 263"):
        make()(torch.zeros(1, 8, 67))
    with pytest.raises(ValueError, match=r"BodyPartEncoder.layers=0: must be a whole number from 1"):
        make(layers=0)
    with pytest.raises(ValueError, match=r"BodyPartEncoder.skeleton=dog: must be one of humanml3d, kit"):
        make(skeleton="dog")
    with pytest.raises(ValueError, match="kind=full: must be one of"):
        make("full")
