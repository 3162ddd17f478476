"""Encode motion through its body parts: attention over the joints of each frame, then the conv encoder (AttT2M)."""

from __future__ import annotations

import math
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.motion.representation import Representation
from kinema.motion.skeleton import DIMS, SKELETONS, Skeleton
from kinema.nn.conv import ConvEncoder
from kinema.nn.embeddings import sinusoidal_positions
from kinema.nn.transformer import TransformerBlock
from kinema.options import Depth, Levels, OneOf, OpenShare, Size, checked
from kinema.registry import buildable

CONTACT_CHAINS = {"humanml3d": (3, 4), "kit": (0, 1)}
"""The chains that the foot contacts are counted to, as published: KIT's legs, HumanML3D's arms (AttT2M, Tokenizer)."""


@buildable
class BodyPartEncoder(nn.Module):
    """Map normalised motion (b, t, d) to (b, t // 2**down_levels, code_dim): a tokenizer's encoder.

    A frame becomes nodes: the root (its four columns and its velocity), each other joint (position, rotation,
    velocity) and the foot contacts. One learned token per chain of the skeleton attends to the chain's nodes; the
    conv encoder reads the tokens side by side. Essential features have no rotations, velocities and contacts: their
    nodes are the root's four columns and the joints' three, without a node for contacts (not published).
    `root_scale` multiplies the root's and the contacts' columns (published: 1): the T2M family's statistics magnify
    them 25 times, and behind layer norms a small model sees little but the sign of such a number.
    """

    mask: Bool[Tensor, "k k"]

    @checked
    def __init__(
        self,
        skeleton: Annotated[str, OneOf(SKELETONS)],
        kind: Annotated[str, OneOf(DIMS)],
        *,
        code_dim: Size = 512,
        width: Size = 512,
        down_levels: Levels = 2,
        depth: Depth = 3,
        dilation_growth: Size = 3,
        node_width: Size = 32,
        node_hidden: Size = 512,
        part_width: Size = 128,
        feedforward: Size = 512,
        layers: Depth = 2,
        heads: Size = 4,
        dropout: OpenShare = 0.2,
        root_scale: float = 1.0,
    ) -> None:
        super().__init__()
        self.root_scale = root_scale
        read = Representation(kind, skeleton)
        self.skeleton, self.groups, self.input_dim = read.skeleton, read.groups, read.width
        redundant = "contacts" in self.groups
        self.root = nn.Linear(7 if redundant else 4, node_width)
        self.joint = nn.Linear(12 if redundant else 3, node_width)
        self.contact = nn.Linear(4, node_width) if redundant else None
        self.token = nn.Sequential(nn.Linear(node_width, node_hidden), nn.ReLU(), nn.Linear(node_hidden, part_width))
        self.parts = nn.Parameter(0.1 * torch.randn(len(self.skeleton.chains), part_width))
        self.blocks = nn.ModuleList(
            TransformerBlock(part_width, heads, feedforward, dropout, norm="post") for _ in range(layers)
        )
        self.dropout = nn.Dropout(dropout)
        self.conv = ConvEncoder(
            self.parts.numel(), code_dim, width=width, levels=down_levels, depth=depth, dilation_growth=dilation_growth
        )
        self.register_buffer("mask", part_mask(self.skeleton, contacts=redundant), persistent=False)

    def forward(self, x: Float[Tensor, "b t d"], lengths: Int[Tensor, " b"] | None = None) -> Float[Tensor, "b n c"]:
        """Encode; frames past the lengths change nothing."""
        return self.conv(self.part_tokens(x).flatten(2), lengths)

    def part_tokens(self, x: Float[Tensor, "b t d"]) -> Float[Tensor, "b t p w"]:
        """Return what each part's token has read from its frame."""
        nodes = self.token(self.nodes(x).flatten(0, 1))
        count, width = nodes.shape[1:]
        nodes = self.dropout(nodes * math.sqrt(width) + sinusoidal_positions(count, width, x.device).to(nodes.dtype))
        tokens = torch.cat([self.parts.expand(len(nodes), -1, -1), nodes], dim=1)
        for block in self.blocks[:-1]:
            tokens = block(tokens, self.mask[None])
        # Nobody reads the nodes after the last block: it computes the parts alone.
        count = len(self.parts)
        parts = self.blocks[-1](tokens[:, :count], self.mask[None, :count], context=tokens)
        return parts.unflatten(0, x.shape[:2])

    def nodes(self, x: Float[Tensor, "b t d"]) -> Float[Tensor, "b t j w"]:
        """Embed the root, the other joints and, on redundant features, the contacts of each frame."""
        if x.shape[-1] != self.input_dim:
            raise ValueError(f"features have {x.shape[-1]} columns, this encoder reads {self.input_dim}")
        root = [self.root_scale * x[..., : self.groups["root_height"].stop]]
        joints = [self._per_joint(x, "joints", 3)]
        if self.contact is None:
            return torch.cat([self.root(root[0])[..., None, :], self.joint(joints[0])], dim=-2)
        velocities = self._per_joint(x, "velocities", 3)
        root.append(velocities[..., 0, :])
        joints += [self._per_joint(x, "rotations", 6), velocities[..., 1:, :]]
        contacts = self.contact(self.root_scale * x[..., self.groups["contacts"]])
        embedded = self.root(torch.cat(root, -1))[..., None, :], self.joint(torch.cat(joints, -1))
        return torch.cat([*embedded, contacts[..., None, :]], dim=-2)

    def _per_joint(self, x: Float[Tensor, "b t d"], group: str, size: int) -> Float[Tensor, "b t j s"]:
        return x[..., self.groups[group]].unflatten(-1, (-1, size))


def part_mask(skeleton: Skeleton, *, contacts: bool) -> Bool[Tensor, "k k"]:
    """Say who sees whom: part tokens, then joints, then (with `contacts`) the contact node.

    A part sees itself and its chain, a joint those it shares a chain with; the root and the contacts are seen by all,
    part tokens by nobody else (AttT2M, Tokenizer).
    """
    parts = len(skeleton.chains)
    size = parts + skeleton.num_joints + contacts
    mask = torch.eye(size, dtype=torch.bool)
    for part, chain in enumerate(skeleton.chains):
        nodes = torch.tensor(chain) + parts
        if contacts and part in CONTACT_CHAINS[skeleton.name]:
            nodes = torch.cat([nodes, torch.tensor([size - 1])])
        mask[part, nodes] = True
        mask[nodes[:, None], nodes] = True
    mask[:, parts] = True
    if contacts:
        mask[:, -1] = True
    return mask
