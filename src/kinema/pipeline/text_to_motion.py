"""Hold a tokenizer, a generator and a text encoder as one thing that turns text into motion, and edits motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import Skeleton
from kinema.nn.mode import inference
from kinema.pipeline.arguments import batches, check_length, frame_counts, paired, sample_seeds
from kinema.pipeline.chaining import bridges, join
from kinema.pipeline.compatibility import check_pair, check_representation
from kinema.pipeline.editing import edited_frames, kept_latents, resolve_ranges, stack_sources
from kinema.pipeline.kept import encode_kept
from kinema.runs import weights as artifacts
from kinema.runs.parts import load_part, new_folder, read_json, write_json
from kinema.text.encoders import FrozenTextEncoder, build_text_encoder, check_texts
from kinema.types import Latents, Motion, MotionBatch

LINKED = "linked"
"""Take the part that the run's upstream.json names."""


class TextToMotion:
    """Generate and edit motion from text.

    `meta["text"]` = {"encoder": name, "path": ...} says how the text encoder is made again; `save` needs it.
    """

    def __init__(
        self,
        tokenizer: nn.Module,
        generator: nn.Module,
        text_encoder: FrozenTextEncoder,
        length_estimator: nn.Module | None = None,
        meta: dict[str, Any] | None = None,
    ) -> None:
        check_pair(tokenizer, generator)
        self.tokenizer = tokenizer
        self.generator = generator
        self.text_encoder = text_encoder
        self.length_estimator = length_estimator
        self.meta = dict(meta or {})

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
        unit = self.tokenizer.downsample
        latents = (self.skeleton.max_frames - 1) // unit
        return min(latents, getattr(self.generator, "max_latents", latents)) * unit

    def to(self, device: torch.device | str) -> TextToMotion:
        """Move the weights; text features follow them."""
        for module in self._modules():
            module.to(best_device(device))
        return self

    def generate(
        self,
        texts: str | Sequence[str],
        frames: int | Sequence[int] | None = None,
        *,
        seconds: float | Sequence[float] | None = None,
        seed: int | None = None,
        batch_size: int = 32,
        **sampling: Any,
    ) -> list[Motion]:
        """Generate one motion per text, `frames` or `seconds` long (one value, or one per text).

        Without a length, a generator that ends its sequences itself decides, else the length estimator.

        Keyword arguments replace fields of the generator's sampling. The same seed gives the same list; a motion's
        own `seed` gives it again alone. Raises ValueError for empty texts, lengths out of range, unknown fields.
        """
        texts = check_texts([texts] if isinstance(texts, str) else list(texts))
        options = self._sampling(sampling)
        seeds = sample_seeds(seed, len(texts))
        counts = self._lengths(frames, seconds, len(texts))
        motions = []
        with self._inference():
            for part in batches(len(texts), batch_size):
                text = self.text_encoder(texts[part]).to(self.device)
                drawn = torch.tensor(seeds[part])
                wanted = self._estimated(text, drawn) if counts is None else torch.tensor(counts[part])
                asked = None if wanted is None else self._whole(wanted)
                latents = self.generator.sample(text, asked, seeds=drawn, sampling=options)
                decoded = self._decode(latents, latents.frames if wanted is None else wanted)
                motions += self._motions(decoded, texts[part], seeds[part])
        return motions

    def chain(
        self,
        texts: Sequence[str],
        frames: int | Sequence[int] | None = None,
        *,
        seconds: float | Sequence[float] | None = None,
        transition: int = 2,
        seed: int | None = None,
        **sampling: Any,
    ) -> Motion:
        """Generate one long motion: a part per text, joined by generated transitions of `transition` latents.

        Each part is generated alone; between two neighbours the last half of the one and the first half of the other
        are known and the latents between them are generated to the text of the first (BAD §5, MMM). All latents are
        decoded at once. The motion may be longer than any clip of the training.
        """
        texts = check_texts(list(texts))
        options = self._sampling(sampling)
        # A transition draws its own numbers, not those of the part before it.
        seeds = sample_seeds(seed, 2 * len(texts) - 1)
        seeds, between = seeds[: len(texts)], torch.tensor(seeds[len(texts) :])
        counts = self._lengths(frames, seconds, len(texts))
        with self._inference():
            text, drawn = self.text_encoder(texts).to(self.device), torch.tensor(seeds)
            wanted = self._estimated(text, drawn) if counts is None else torch.tensor(counts)
            asked = None if wanted is None else self._whole(wanted)
            parts = self.generator.sample(text, asked, seeds=drawn, sampling=options)
            if len(texts) > 1:
                known = bridges(parts, transition, self.max_frames // self.tokenizer.downsample)
                first = self.text_encoder(texts[:-1]).to(self.device)
                bridged = self.generator.sample(first, None, seeds=between, known=known, sampling=options)
                parts = join(parts, bridged, ~known.mask & known.latents.mask)
            (motion,) = self._motions(self.tokenizer.decode(parts), ["; ".join(texts)], [seeds[0]])
        return motion

    def edit(
        self,
        motions: Motion | Sequence[Motion],
        texts: str | Sequence[str],
        frames: str | Sequence,
        *,
        seed: int | None = None,
        batch_size: int = 32,
        paste: bool = True,
        **sampling: Any,
    ) -> list[Motion]:
        """Regenerate `frames` of each motion to its text: (start, end) ranges or prefix|suffix|inbetween|outpaint.

        Kept feature rows come back bit-equal; the root is integrated from the rows, so that what follows an edit
        moves on from where the edit ends. `paste=False` gives the raw decoding, which the papers' tables use.
        """
        motions, texts = paired(motions, texts)
        options = self._sampling(sampling)
        self._check_sources(motions)
        ranges = resolve_ranges(frames, [len(m.features) for m in motions])
        seeds = sample_seeds(seed, len(motions))
        edited = []
        with self._inference():
            for part in batches(len(motions), batch_size):
                batch = self._edit_batch(motions[part], texts[part], ranges[part], seeds[part], options, paste)
                edited += self._motions(batch, texts[part], seeds[part])
        return edited

    def _edit_batch(
        self, motions: list[Motion], texts: list[str], ranges: list, seeds: list[int], options: Any, paste: bool
    ) -> MotionBatch:
        unit = self.tokenizer.downsample
        source, counts, filled = stack_sources(motions, self.tokenizer.representation.width, unit)
        regenerate = edited_frames(ranges, source.shape[1])
        source, regenerate = source.to(self.device), regenerate.to(self.device)
        whole = MotionBatch(source, filled.to(self.device))
        latents = self.generator.sample(
            self.text_encoder(texts).to(self.device),
            whole.lengths,
            seeds=torch.tensor(seeds),
            known=encode_kept(self.tokenizer, whole, kept_latents(regenerate, unit)),
            sampling=options,
        )
        result = self._decode(latents, counts)
        if paste:
            keep = (result.mask & ~regenerate)[..., None]
            result.features = torch.where(keep, source, result.features)
        return result

    def _decode(self, latents: Latents, frames: Tensor) -> MotionBatch:
        return self.tokenizer.decode(replace(latents, frames=frames.to(self.device)))

    def _motions(self, batch: MotionBatch, texts: list[str], seeds: list[int]) -> list[Motion]:
        joints = recover_joints(batch.features, self.skeleton).cpu().numpy()
        rows = zip(batch.features.cpu().numpy(), joints, batch.lengths.tolist(), texts, seeds, strict=True)
        name, fps = self.skeleton.name, self.skeleton.fps
        return [Motion(j[:n].copy(), f[:n].copy(), text, name, fps, seed) for f, j, n, text, seed in rows]

    def _whole(self, frames: Tensor) -> Tensor:
        unit = self.tokenizer.downsample
        return ((frames + unit - 1) // unit * unit).to(self.device)

    def _sampling(self, changes: dict[str, Any]) -> Any:
        allowed = [f.name for f in fields(self.generator.sampling)]
        for name in changes:
            if name not in allowed:
                raise ValueError(f"unknown sampling field {name!r}; allowed: {', '.join(allowed)}")
        return replace(self.generator.sampling, **changes)

    def _lengths(self, frames: Any, seconds: Any, size: int) -> list[int] | None:
        counts = frame_counts(frames, seconds, size, fps=self.skeleton.fps, maximum=self.max_frames)
        ends_itself = getattr(self.generator, "predicts_length", False)
        if counts is None and self.length_estimator is None and not ends_itself:
            raise ValueError("no length: give frames= or seconds=, or a length estimator (length=RUN, --length RUN)")
        return counts

    def _estimated(self, text: Any, seeds: Tensor) -> Tensor | None:
        if getattr(self.generator, "predicts_length", False):
            return None
        # The published estimator knows a class 0 (MARDM §6); no motion has no frames.
        return self.length_estimator.predict(text, seeds).cpu().clamp(self.tokenizer.downsample, self.max_frames)

    def _check_sources(self, motions: list[Motion]) -> None:
        representation = self.tokenizer.representation
        for i, motion in enumerate(motions):
            if motion.skeleton != self.skeleton.name:
                raise ValueError(f"motion {i} has the skeleton {motion.skeleton!r}, the model {self.skeleton.name!r}")
            if motion.features.shape[1] < representation.width:
                raise ValueError(
                    f"motion {i} has {motion.features.shape[1]} feature columns, this model ({representation.kind}) "
                    f"needs {representation.width}; extract them from its joints with kinema.motion.features.extract"
                )
            if not np.isfinite(motion.features).all():
                raise ValueError(f"motion {i} holds NaN or infinite features; repair it before editing")
            check_length(len(motion.features), self.max_frames, self.skeleton.fps)

    def _modules(self) -> list[nn.Module]:
        return [m for m in (self.tokenizer, self.generator, self.length_estimator) if m is not None]

    @contextmanager
    def _inference(self) -> Iterator[None]:
        """Switch all parts to inference, and back: a model in training may be asked for samples."""
        with ExitStack() as stack:
            for module in self._modules():
                stack.enter_context(inference(module))
            yield

    @classmethod
    def from_run(
        cls,
        path: str | Path,
        device: torch.device | str | None = None,
        *,
        length: str | Path | None = None,
        residual: str | Path | None = LINKED,
    ) -> TextToMotion:
        """Load a generator's run folder (or one that `save` wrote) with what it was trained on.

        `length` and `residual` are run folders of a length estimator and a residual transformer; without them those
        that `upstream.json` names are taken (`residual=None`: none). Raises FileNotFoundError or ValueError that name
        the part that is missing or unfit.
        """
        folder, device = Path(path), best_device(device)
        generator, meta = load_part(folder, device)
        if not hasattr(generator, "sample"):
            raise ValueError(f"{folder} holds a {type(generator).__name__}; give the run folder of a generator")
        upstream, text = read_json(folder / "upstream.json"), read_json(folder / "text.json")
        for file, key, names in (("upstream.json", "tokenizer", upstream), ("text.json", "encoder", text)):
            if key not in names:
                raise ValueError(f"{folder / file} names no {key}; train or import this run again")
        tokenizer = load_part(folder / upstream["tokenizer"], device)[0]
        check_representation(meta.get("representation"), tokenizer)
        if residual == LINKED:
            residual = folder / upstream["residual"] if "residual" in upstream else None
        if residual is not None:
            generator = with_residual(generator, load_part(Path(residual), device)[0])
        where = length or (folder / upstream["length"] if "length" in upstream else None)
        encoder = build_text_encoder(text["encoder"], text.get("path"), device)
        if meta.get("text", encoder.identity) != encoder.identity:
            raise ValueError(
                f"{folder} was trained with the text encoder {meta['text']}, this one is {encoder.identity}"
            )
        return cls(
            tokenizer,
            generator,
            encoder,
            load_part(Path(where), device)[0] if where else None,
            {**meta, "text": text},
        )

    def save(self, path: str | Path) -> Path:
        """Write the weights of all parts as one portable folder, whole or not at all; `from_run` loads it anywhere."""
        path = Path(path)
        if "text" not in self.meta:
            raise ValueError('meta has no "text": {"encoder": name, "path": ...}; pass it to TextToMotion to save it')
        parts = {"": self.generator, "tokenizer": self.tokenizer, "length": self.length_estimator}
        parts = {name: module for name, module in parts.items() if module is not None}
        with new_folder(path) as staging:
            for name, module in parts.items():
                meta = {}
                if module is self.generator:
                    meta["text"] = self.text_encoder.identity
                    meta["representation"] = self.tokenizer.representation.identity()
                artifacts.save(module, _spec(module), staging / name / artifacts.WEIGHTS, **meta)
            write_json(staging / "upstream.json", {name: name for name in parts if name})
            write_json(staging / "text.json", self.meta["text"])
            write_json(staging / "status.json", {"state": "done"})
        return path


def best_device(device: torch.device | str | None = None) -> torch.device:
    """Choose cuda, else mps, else the CPU; or check that the one asked for is there."""
    if device is None:
        if torch.cuda.is_available():
            return torch.device("cuda")
        return torch.device("mps" if torch.backends.mps.is_available() else "cpu")
    try:
        return torch.empty(0, device=device).device
    except (RuntimeError, AssertionError) as error:  # torch built without CUDA asserts
        reason = str(error).splitlines()[0]
        raise ValueError(f"device {str(device)!r} cannot be used here ({reason}); choose {best_device()}") from None


def with_residual(base: nn.Module, residual: nn.Module) -> nn.Module:
    """Let a residual transformer complete the codes of a base generator."""
    from kinema.generators.momask.cascade import Cascade

    both = Cascade(base=base, residual=residual)
    both.spec = {"_target_": "kinema.generators.momask.Cascade", "base": _spec(base), "residual": _spec(residual)}
    return both.to(next(base.parameters()).device).eval()


def _spec(module: nn.Module) -> dict[str, Any]:
    spec = getattr(module, "spec", None)
    if spec is None:
        raise ValueError(
            f"this {type(module).__name__} has no spec to save with; set module.spec to what it was built from"
        )
    return spec
