"""Generate many motions into files named by a template, with a manifest that says how each is made again."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinema.cli.exporting import stand
from kinema.motion import export
from kinema.pipeline import TextToMotion
from kinema.pipeline.arguments import batches
from kinema.pipeline.identity import fingerprint, sampling_of
from kinema.pipeline.models import DEFAULT, find_model
from kinema.pipeline.naming import folder_of, name_files
from kinema.pipeline.requests import Take
from kinema.runs.console import printable
from kinema.runs.versions import versions
from kinema.text import manifest
from kinema.text.manifest import Entry
from kinema.types import Motion


@dataclass(frozen=True)
class Batch:
    """Hold what is asked for, the files that it goes to, and the folder whose manifest names them."""

    asked: Sequence[Take]
    files: Sequence[Path]
    folder: Path

    @classmethod
    def named(cls, out: str, asked: Sequence[Take]) -> Batch:
        """Name the files by a template; refuses names that clash and a manifest that cannot be read."""
        batch = cls(asked, name_files(out, asked), folder_of(out))
        if (batch.folder / manifest.NAME).exists():
            manifest.read_manifest(batch.folder / manifest.NAME)
        return batch

    def write(self, model: TextToMotion, lengths: Sequence[int | None], options: argparse.Namespace) -> None:
        """Generate, save and note batch by batch: what is interrupted leaves files that are whole, each with a line."""
        made_with = _made_with(model, options)
        for part in batches(len(self.asked), options.batch_size):
            takes, counts = self.asked[part], list(lengths[part])
            texts, seeds = [take.prompt.text for take in takes], [take.seed for take in takes]
            motions = model.generate(texts, counts, seed=seeds, batch_size=options.batch_size, **options.set)
            motions = stand(motions) if options.lock_feet else motions
            entries = []
            try:
                for take, motion, file, count in zip(takes, motions, self.files[part], counts, strict=True):
                    export.save(motion, file)
                    entries.append(self._entry(take, motion, file, asked=count is not None, made_with=made_with))
            finally:
                path = manifest.add(self.folder, entries) if entries else self.folder / manifest.NAME
            print(printable(f"made      {takes[-1].index} of {len(self.asked)}: {self.files[part][-1]}"))
        print(printable(f"wrote {len(self.files)} motions, and {path} that says how to make each again"))

    def _entry(self, take: Take, motion: Motion, file: Path, *, asked: bool, made_with: dict[str, Any]) -> Entry:
        return Entry(
            file=file.relative_to(self.folder).as_posix(),
            text=motion.text,
            seed=take.seed,
            frames=len(motion.joints),
            length="asked" if asked else "model",
            fps=motion.fps,
            take=take.take,
            name=take.prompt.name,
            skeleton=motion.skeleton,
            **made_with,
        )


def check_made(asked: Sequence[Take], model: TextToMotion, options: argparse.Namespace) -> None:
    """Refuse to make the motions of a manifest again with another model or other options."""
    entries = [take.prompt.entry for take in asked if take.prompt.entry is not None]
    if not entries:
        return
    if options.count > 1 or options.frames is not None or options.seconds is not None:
        raise ValueError(
            "--count, --frames and --seconds would make other motions than a manifest says: leave them out"
        )
    own, sampling = fingerprint(model), sampling_of(model, options.set)
    for entry in entries:
        if entry.model != own:
            raise ValueError(
                f"{entry.file} was made by {entry.run} (model {entry.model}), and this is model {own}: give its --run"
            )
        if other := [f"--set {key}={value}" for key, value in entry.sampling.items() if sampling.get(key) != value]:
            raise ValueError(f"{entry.file} was made with {' '.join(other)}: give these, or leave its line out")
        if entry.lock_feet != options.lock_feet:
            raise ValueError(
                f"{entry.file} was made {'with' if entry.lock_feet else 'without'} --lock-feet: do so again"
            )


def _made_with(model: TextToMotion, options: argparse.Namespace) -> dict[str, Any]:
    return {
        "run": find_model(options.run or DEFAULT).name if model.card is None else model.card.name,
        "model": fingerprint(model),
        "method": type(model.generator).__name__,
        "sampling": sampling_of(model, options.set),
        "lock_feet": options.lock_feet,
        "batch_size": options.batch_size,
        "device": model.device.type,
        "versions": {name: value for name, value in versions().items() if name in ("kinema", "torch", "revision")},
    }
