"""Match motion and text by distance: Guo et al.'s evaluator (T2M_EVALUATOR, MARDM §7)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from kinema.evaluation.encoders.base import TextMotionEvaluator, caption_keys, false_negatives, symmetric_cross_entropy
from kinema.evaluation.encoders.t2m_networks import MovementDecoder, MovementEncoder, SequenceEncoder, WordEncoder
from kinema.motion.representation import Representation
from kinema.nn.ranks import gather
from kinema.options import NonNegative, OneOf, Positive, Size, checked
from kinema.registry import buildable
from kinema.types import Caption, Losses, MotionBatch

UNIT = 4
"""Frames per movement code."""
CONTACTS = 4
SHIFTS = ("nonzero", "legacy")
PADDINGS = ("masked", "legacy")
OBJECTIVES = ("margin", "infonce")


@buildable
class DecompositionAutoencoder(nn.Module):
    """Pre-train the movement encoder on short windows (stage 1, T2M_EVALUATOR §3).

    `drop_contacts` hides the four contact columns from the encoder (the original 263/251-dim evaluator); the target
    keeps them.
    """

    @checked
    def __init__(
        self, representation: Representation, *, width: Size = 512, latent_dim: Size = 512, drop_contacts: bool = False
    ) -> None:
        super().__init__()
        self.representation = representation
        self.drop_contacts = drop_contacts
        self.movement_encoder = MovementEncoder(_inputs(representation, drop_contacts), width, latent_dim)
        self.movement_decoder = MovementDecoder(latent_dim, width, representation.width)

    def loss(
        self, batch: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Return L1 plus 0.001 mean|z| (sparsity) plus 0.001 L1 of consecutive codes (smoothness); nothing is drawn."""
        target = self.representation.normalize(batch.features, batch.lengths)
        codes = self.movement_encoder(target[..., :-CONTACTS] if self.drop_contacts else target)
        output = self.movement_decoder(codes)
        reconstruction = F.l1_loss(output, target[:, : output.shape[1]])
        sparsity, smoothness = codes.abs().mean(), F.l1_loss(codes[:, 1:], codes[:, :-1])
        loss = reconstruction + 0.001 * sparsity + 0.001 * smoothness
        return {"loss": loss, "reconstruction": reconstruction, "sparsity": sparsity, "smoothness": smoothness}


@buildable
class MatchingEvaluator(TextMotionEvaluator):
    """Embed motion and text so that a caption lies near its motion (stage 2, T2M_EVALUATOR §4-§5).

    `negative_shift`: "nonzero" never pairs a negative with its own positive; "legacy" draws the shift from 0..B-2 and
    applies it to the batch sorted by descending length. `padding`: "masked" gives the movement encoder zeros past a
    clip's end, as the published code gives them for real motion; "legacy" whatever stands there, for motion that brings
    frames past its end (batches of ours have zeros there before normalisation, which are no motion). A clip of exactly
    `max_frames` ends where the published zero-padded input ended, so it sees the convolution's own padding.
    `objective`: "margin" is the paper's; "infonce" contrasts the whole batch by squared distance over `temperature`,
    leaving out negatives whose caption says the same.
    """

    @checked
    def __init__(
        self,
        representation: Representation,
        *,
        word_width: Size,
        movement_width: Size = 512,
        movement_dim: Size = 512,
        motion_hidden: Size = 1024,
        text_hidden: Size = 512,
        embedding: Size = 512,
        margin: NonNegative = 10.0,
        negative_shift: Annotated[str, OneOf(SHIFTS)] = "nonzero",
        padding: Annotated[str, OneOf(PADDINGS)] = "masked",
        drop_contacts: bool = False,
        objective: Annotated[str, OneOf(OBJECTIVES)] = "margin",
        temperature: Positive = 10.0,
        max_frames: Size = 196,
    ) -> None:
        super().__init__(representation, {"padding": padding, "drop_contacts": drop_contacts, "max_frames": max_frames})
        self.padding, self.drop_contacts, self.max_frames = padding, drop_contacts, max_frames
        self.margin, self.negative_shift = margin, negative_shift
        self.objective, self.temperature = objective, temperature
        self.movement_encoder = MovementEncoder(_inputs(representation, drop_contacts), movement_width, movement_dim)
        self.movement_encoder.requires_grad_(False).eval()
        self.motion_encoder = SequenceEncoder(movement_dim, motion_hidden, embedding)
        self.text_encoder = WordEncoder(word_width, text_hidden, embedding)

    def train(self, mode: bool = True) -> MatchingEvaluator:
        """Switch the mode; the frozen movement encoder stays in eval mode."""
        super().train(mode)
        self.movement_encoder.eval()
        return self

    def load_movement(self, stage: DecompositionAutoencoder) -> MatchingEvaluator:
        """Take over the pre-trained movement encoder; it must read the same representation."""
        if not self.representation.agrees(stage.representation) or self.drop_contacts != stage.drop_contacts:
            raise ValueError(
                f"the movement encoder was pre-trained on {stage.representation.identity()} (drop_contacts="
                f"{stage.drop_contacts}), this evaluator reads {self.representation.identity()} (drop_contacts="
                f"{self.drop_contacts}); train the decomposition stage anew"
            )
        self.movement_encoder.load_state_dict(stage.movement_encoder.state_dict())
        return self

    @torch.no_grad()
    def movements(self, batch: MotionBatch) -> Float[Tensor, "b n c"]:
        """Encode the frozen movement codes that the motion encoder reads (they can be kept between epochs)."""
        lengths = batch.lengths if self.padding == "masked" else None
        motion = self.representation.normalize(batch.features, lengths)
        if self.drop_contacts:
            motion = motion[..., :-CONTACTS]
        if self.padding == "masked":
            motion = self._to_common_end(motion, int(batch.lengths.max()))
        return self.movement_encoder(motion)

    def embed_motion(self, batch: MotionBatch) -> Float[Tensor, "b e"]:
        """Embed motions of at least four frames, in the order given; not normalised."""
        return self._embed_movements(self.movements(batch), batch)

    def embed_text(self, captions: Sequence[Caption]) -> Float[Tensor, "b e"]:
        """Embed captions, in the order given; not normalised."""
        words, classes, lengths = self.vocabulary(list(captions), self.representation.mean.device)
        return self.text_encoder.embed(words, classes, lengths)

    def loss(
        self,
        batch: MotionBatch,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        movements: Float[Tensor, "b n c"] | None = None,
    ) -> Losses:
        """Contrast over the batch of all ranks; `generator` must be in the same state on each of them.

        `shard` = (rank, ranks that share the batch); each of them computes the whole loss from gathered embeddings.
        """
        codes = self.movements(batch) if movements is None else movements
        motion = gather(self._embed_movements(codes, batch), shard[1])
        text = gather(self.embed_text(batch.captions), shard[1])
        if self.objective == "infonce":
            return self._infonce(text, motion, gather(caption_keys(batch.texts, text.device), shard[1]))
        return self._margin(text, motion, gather(batch.lengths, shard[1]), generator)

    def _margin(self, text: Tensor, motion: Tensor, lengths: Tensor, generator: torch.Generator | None) -> Losses:
        """Return mean d(t_i, m_i)^2 + mean max(0, margin - d(t_i, m_(i+s)))^2 (T2M_EVALUATOR §4)."""
        shift = draw_shift(len(text), self.negative_shift, generator)
        if self.negative_shift == "legacy":
            order = torch.argsort(lengths, stable=True).flip(0)
            text, motion = text[order], motion[order]
        return margin_losses(text, motion, shift, self.margin)

    def _infonce(self, text: Tensor, motion: Tensor, keys: Tensor) -> Losses:
        logits = -torch.cdist(text, motion).square() / self.temperature
        return {"loss": symmetric_cross_entropy(logits.masked_fill(false_negatives(keys), -torch.inf))}

    def _embed_movements(self, codes: Tensor, batch: MotionBatch) -> Tensor:
        lengths = batch.lengths.cpu()
        if int(lengths.min()) < UNIT:
            short = int(lengths.argmin())
            name = batch.clip_ids[short] if batch.clip_ids else f"row {short}"
            raise ValueError(f"{name} has {int(lengths[short])} frames; the evaluator needs at least {UNIT}")
        return self.motion_encoder(codes, lengths // UNIT)

    def _to_common_end(self, motion: Tensor, longest: int) -> Tensor:
        """Pad or crop to where the batch's longest clip sees what it would see in any other batch."""
        if longest > self.max_frames:
            raise ValueError(
                f"a motion of {longest} frames is longer than the evaluator's max_frames={self.max_frames}; crop it, "
                "or build the evaluator with a larger max_frames"
            )
        end = min(longest + UNIT, self.max_frames)
        return F.pad(motion[:, :end], (0, 0, 0, max(0, end - motion.shape[1])))


def draw_shift(size: int, rule: str, generator: torch.Generator | None) -> int:
    """Draw which neighbour is the negative: uniform on 1..B-1, or on 0..B-2 as published."""
    if size < 2:
        raise ValueError(f"the margin objective needs a batch of at least 2 pairs, got {size}; raise the batch size")
    low = 1 if rule == "nonzero" else 0
    device = generator.device if generator is not None else "cpu"
    return int(torch.randint(low, low + size - 1, (1,), generator=generator, device=device))


def margin_losses(text: Float[Tensor, "b e"], motion: Float[Tensor, "b e"], shift: int, margin: float) -> Losses:
    """Pull text i to motion i and push it from motion (i + shift) mod B."""
    positive = F.pairwise_distance(text, motion).square().mean()
    negative = (margin - F.pairwise_distance(text, motion.roll(-shift, 0))).clamp(min=0).square().mean()
    return {"loss": positive + negative, "positive": positive, "negative": negative}


def _inputs(representation: Representation, drop_contacts: bool) -> int:
    if drop_contacts and representation.kind != "redundant":
        raise ValueError(
            f"drop_contacts=True needs the redundant representation, got {representation.kind!r}: the essential "
            "columns hold no contacts; set drop_contacts=False"
        )
    return representation.width - (CONTACTS if drop_contacts else 0)
