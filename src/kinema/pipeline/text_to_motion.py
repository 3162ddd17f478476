"""Hold a tokenizer, a generator and a text encoder as one thing that turns text into motion, and edits motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import fields, replace
from typing import Any, cast

import torch
from jaxtyping import Int
from torch import Tensor, nn

from kinema.devices import find_device
from kinema.generators.length import LengthEstimator
from kinema.motion.body_parts import PARTS
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import Skeleton
from kinema.nn.mode import inference
from kinema.nn.precision import cast_products, computing
from kinema.options import Count, check, check_value
from kinema.pipeline.arguments import BATCH, batches, batches_by_length, check_sources, frame_counts, paired
from kinema.pipeline.blending import BLEND, Seconds, put_back
from kinema.pipeline.chaining import TRANSITION, chained
from kinema.pipeline.editing import (
    Ranges,
    edited_features,
    edited_frames,
    in_place,
    kept_latents,
    resolve_ranges,
    stack_sources,
    widened,
)
from kinema.pipeline.kept import encode_kept, encode_kept_features
from kinema.pipeline.portable import Portable
from kinema.runs.parts import LENGTH
from kinema.seeds import request_seeds
from kinema.text.frozen import check_texts
from kinema.types import Known, Latents, Motion, MotionBatch, TextFeatures

CROP = 4
"""Frames that training's crops are multiples of."""


class TextToMotion(Portable):
    """Generate and edit motion from text; `Portable` says what it holds and how it is read and written."""

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of the motions."""
        return self.tokenizer.representation.skeleton

    @property
    def device(self) -> torch.device:
        """The device that the weights are on."""
        return next(self.generator.parameters()).device

    @property
    def max_frames(self) -> int:
        """The longest motion that training knew (196 frames: whole latents below the skeleton's limit)."""
        space, longest = self.generator.space, self.skeleton.max_frames - 1
        if space.unit is None:
            return longest // CROP * CROP
        return space.frames_of(min(space.latents_of(longest), space.most, self.tokenizer.space.most))

    @property
    def knows_lengths(self) -> bool:
        """Whether a motion without a length can be asked for: the generator ends it, or an estimator says when."""
        return self.generator.predicts_length or LENGTH in self.parts

    def to(self, device: torch.device | str) -> TextToMotion:
        """Move the weights; text features follow them."""
        for module in self._modules():
            module.to(find_device(device))
        return self

    def eval(self) -> TextToMotion:
        """Put all parts into inference mode."""
        for module in self._modules():
            module.eval()
        return self

    def bfloat16(self) -> TextToMotion:
        """Generate with products in bfloat16 from now on, of weights that are cast once: about half their memory.

        Sums, norms, the steps of a sampler and the text encoder stay in fp32. What it gives depends on the machine
        (docs/frontier.md). Such a model can't be saved: load it again for that. Raises ValueError for a model of joints
        in space, whose places bfloat16 would round to centimetres.
        """
        if self.tokenizer.placed:
            raise ValueError(
                "bfloat16 rounds places in space to centimetres, and this model's motion is of such; use float32"
            )
        for module in self._modules():
            cast_products(module)
        self.precision = "bfloat16"
        return self

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None = None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: Any | None = None,
    ) -> MotionBatch:
        """Generate de-normalised motion: tensors in, tensors out; what users get and what the tables score.

        `frames` may be any number: the last latent is cut. None takes the lengths of `known`, or leaves them to the
        generator or the length estimator. `sampling` replaces the generator's own.
        """
        return self.decode(self.sample_latents(text, frames, seeds=seeds, known=known, sampling=sampling))

    def decode(self, latents: Latents) -> MotionBatch:
        """Decode to de-normalised motion."""
        with self.computing():
            return self.tokenizer.decode(latents)

    def computing(self) -> AbstractContextManager[object]:
        """Compute in the model's precision: around whatever calls its parts by themselves."""
        return computing(self.precision, self.device)

    def sample_latents(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None = None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: Any | None = None,
    ) -> Latents:
        """Generate what `sample` decodes."""
        with self.computing():
            if frames is None and known is None and not self.generator.predicts_length:
                frames = self._estimated(text, seeds)
            asked = None if frames is None else self.generator.space.whole(frames).to(self.device)
            latents = self.generator.sample(text.to(self.device), asked, seeds=seeds, known=known, sampling=sampling)
        return latents if frames is None else replace(latents, frames=frames.to(self.device))

    def generate(
        self,
        texts: str | Sequence[str],
        frames: int | Sequence[int | None] | None = None,
        *,
        seconds: float | Sequence[float | None] | None = None,
        seed: int | list[int] | None = None,
        batch_size: int = BATCH,
        **sampling: Any,
    ) -> list[Motion]:
        """Generate one motion per text, `frames` or `seconds` long (one value, or one per text).

        Where none is given (None), a generator that ends its sequences itself decides, else the length estimator.

        Keyword arguments replace fields of the generator's sampling. The same seed gives the same list, a list of seeds
        is one for each: a motion's own gives it again alone. Raises ValueError for what is empty, unknown or too long.
        """
        texts = check_texts(texts)
        options = self.changed_sampling(sampling)
        seeds = request_seeds(seed, len(texts))
        counts = self.lengths(frames, seconds, len(texts))
        motions: dict[int, Motion] = {}
        with self._inference():
            for part in batches_by_length(counts, batch_size):
                wanted = None if counts[part[0]] is None else torch.tensor([counts[i] for i in part])
                prompts, drawn = [texts[i] for i in part], [seeds[i] for i in part]
                batch = self.sample(self.encode(prompts), wanted, seeds=torch.tensor(drawn), sampling=options)
                motions |= zip(part, self._motions(batch, prompts, drawn), strict=True)
        return [motions[i] for i in range(len(texts))]

    def chain(
        self,
        texts: str | Sequence[str],
        frames: int | Sequence[int | None] | None = None,
        *,
        seconds: float | Sequence[float | None] | None = None,
        transition: int = TRANSITION,
        seed: int | None = None,
        **sampling: Any,
    ) -> Motion:
        """Generate one long motion: a part per text, joined by generated transitions of `transition` frames.

        Each part is generated alone; between two neighbours the last half of the one and the first half of the other
        are known and what is between them, in whole latents, is generated to the text of the first (BAD §5, MMM;
        `pipeline.chaining`). The motion may be longer than any of the training; `kept` marks parts' own frames.
        """
        texts = check_texts(texts)
        check_value(transition, Count, "transition")
        options, space = self.changed_sampling(sampling), self.generator.space
        most = self.max_frames // space.in_time("joining motions")
        # A transition draws its own numbers, not those of the part before it.
        seeds = request_seeds(seed, 2 * len(texts) - 1)
        seeds, between = seeds[: len(texts)], torch.tensor(seeds[len(texts) :])
        counts = self.lengths(frames, seconds, len(texts))
        if None in counts and any(counts):
            raise ValueError("parts of one motion need a length each, or none has one: give --frames or --seconds")
        keep = None
        with self._inference():
            text, drawn = self.encode(texts).to(self.device), torch.tensor(seeds)
            wanted = self._estimated(text, drawn) if None in counts else torch.tensor(counts)
            asked = None if wanted is None else space.whole(wanted).to(self.device)
            parts = self.generator.sample(text, asked, seeds=drawn, sampling=options)
            if len(texts) > 1:
                first = self.text_encoder(texts[:-1]).to(self.device)

                def fill(known: Known) -> Latents:
                    return self.generator.sample(first, None, seeds=between, known=known, sampling=options)

                batch, keep = chained(self.tokenizer, parts, transition, most, fill)
            else:
                batch = self.tokenizer.decode(parts)
            (motion,) = self._motions(batch, ["; ".join(texts)], [seeds[0]], keep)
        return motion

    def edit(
        self,
        motions: Motion | Sequence[Motion],
        texts: str | Sequence[str],
        frames: str | Sequence[Any] | None = None,
        *,
        parts: str | None = None,
        seed: int | list[int] | None = None,
        batch_size: int = BATCH,
        paste: bool = True,
        blend: float = BLEND,
        **sampling: Any,
    ) -> list[Motion]:
        """Regenerate `frames` of each motion to its text: (start, end) ranges or prefix|suffix|inbetween|outpaint.

        `parts` ("upper", "lower", "body": all but the root's way) regenerates that part alone, in `frames` or (None) in
        the whole motion; only methods that generate frames can. A task's name says what stays: the first half, the
        second, both ends, the middle. Kept features come back bit-equal, and the motion stands and faces as its joints
        did; the root is integrated from the rows, so that what follows an edit moves on from where the edit ends. A
        kept stretch that fills no latent is widened to those it touches. New frames begin where kept ones end: within
        `blend` seconds they take over what the decoder misses of those (0: not). `paste=False` gives the raw decoding,
        as in tables.
        Raises ValueError if neither is given, if nothing is left to regenerate, or for a negative `blend`.
        """
        motions, texts = paired(motions, texts)
        options = self.changed_sampling(sampling)
        check_sources(motions, self.tokenizer.representation, self.max_frames)
        if frames is None and parts is None:
            raise ValueError(f"nothing to regenerate: give frames, or parts= one of {', '.join(PARTS)}")
        check_value(blend, Seconds, "blend")
        if parts is not None:
            self.tokenizer.space.in_frames("regenerating a part of the body")
        sizes = [len(m.features) for m in motions]
        ranges = [[(0, size)] for size in sizes] if frames is None else resolve_ranges(frames, sizes)
        seeds = request_seeds(seed, len(motions))
        edited = []
        with self._inference():
            for part in batches(len(motions), batch_size):
                source, counts, filled = stack_sources(
                    motions[part], self.tokenizer.representation.width, self.tokenizer.space
                )
                whole = MotionBatch(source, filled).to(self.device)
                keep, known = self._known(whole, counts.to(self.device), ranges[part], parts)
                text, drawn = self.encode(texts[part]), torch.tensor(seeds[part])
                batch = self.sample(text, counts, seeds=drawn, known=known, sampling=options)
                if self.tokenizer.placed and parts == "lower":
                    # Joints that were held in space are there; rows about the old root would move them along.
                    keep = keep.all(-1, keepdim=True).expand_as(keep)
                if paste:
                    batch = self.tokenizer.described(batch, whole.features, keep)
                    batch = put_back(batch, whole.features, keep, self.skeleton, blend)
                edited += self._motions(batch, texts[part], seeds[part], keep if paste else None)
        return [in_place(made, source, self.skeleton) for made, source in zip(edited, motions, strict=True)]

    def _known(self, whole: MotionBatch, sizes: Tensor, ranges: list[Ranges], part: str | None) -> tuple[Tensor, Known]:
        """Return what an edit keeps of clips of so many frames, as a mask over frames or features and as latents."""
        size, width = whole.features.shape[1:]
        regenerate = edited_frames(ranges, size).to(self.device)
        if part is None:
            regenerate = widened(regenerate, sizes, self.tokenizer.space)
            kept = kept_latents(regenerate, self.tokenizer.space)
            return ~regenerate, encode_kept(self.tokenizer, whole, kept)
        keep = ~edited_features(regenerate, part, self.skeleton, width)
        return keep, encode_kept_features(self.tokenizer, whole, keep)

    def _motions(
        self, batch: MotionBatch, texts: list[str], seeds: list[int], keep: Tensor | None = None
    ) -> list[Motion]:
        joints = recover_joints(batch.features, self.skeleton).cpu().numpy()
        rows = zip(batch.features.cpu().numpy(), joints, batch.lengths.tolist(), texts, seeds, strict=True)
        name, fps = self.skeleton.name, self.skeleton.fps
        made = [Motion(j[:n].copy(), f[:n].copy(), text, name, fps, seed) for f, j, n, text, seed in rows]
        if keep is None:
            return made
        whole = (keep if keep.ndim == 2 else keep.all(-1)).cpu().numpy()
        return [replace(motion, kept=row[: len(motion.joints)]) for motion, row in zip(made, whole, strict=True)]

    def changed_sampling(self, changes: Mapping[str, Any]) -> Any:
        """Return the generator's sampling with other fields.

        Raises ValueError for one that is unknown or wrong, or that this generator cannot sample by.
        """
        allowed = [f.name for f in fields(self.generator.sampling)]
        for name in changes:
            if name not in allowed:
                raise ValueError(f"unknown sampling field {name!r}; allowed: {', '.join(allowed)}")
        check(type(self.generator.sampling), changes, "sampling")
        changed = replace(self.generator.sampling, **changes)
        self.generator.check_sampling(changed)
        return changed

    def lengths(self, frames: Any, seconds: Any, size: int) -> list[int | None]:
        """Return the frames of each of `size` motions (None: the model's to say); refuse what cannot be generated."""
        counts = frame_counts(frames, seconds, size, fps=self.skeleton.fps, maximum=self.max_frames)
        if None in counts and not self.knows_lengths:
            raise ValueError("no length: give frames= or seconds=, or a length estimator (length=RUN, --length RUN)")
        return counts

    def _estimated(self, text: TextFeatures, seeds: Int[Tensor, " b"]) -> Int[Tensor, " b"] | None:
        """Estimate frames; None where the generator ends its sequences itself."""
        if self.generator.predicts_length:
            return None
        if LENGTH not in self.parts:
            raise ValueError("no lengths: they need a generator that ends its sequences itself or a length estimator")
        # The published estimator knows a class 0 (MARDM §6); no motion has no frames.
        least = self.generator.space.whole(1)
        estimator = cast(LengthEstimator, self.parts[LENGTH])
        return estimator.predict(text.to(self.device), seeds).cpu().clamp(least, self.max_frames)

    def _modules(self) -> list[nn.Module]:
        return [self.tokenizer, self.generator, *self.parts.values()]

    @contextmanager
    def _inference(self) -> Iterator[None]:
        """Switch all parts to inference, and back: a model in training may be asked for samples."""
        with ExitStack() as stack:
            stack.enter_context(self.computing())
            for module in self._modules():
                stack.enter_context(inference(module))
            yield
