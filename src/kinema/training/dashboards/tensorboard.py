"""Show a run in TensorBoard, which has no players: pages are linked, films move as GIF."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from kinema.training.dashboards.base import About, Dashboard


class TensorBoard(Dashboard):
    """Write one event file."""

    name = "tensorboard"

    def __init__(self, folder: Path, about: About) -> None:
        from torch.utils.tensorboard import SummaryWriter

        super().__init__(folder, about)
        self.writer = SummaryWriter(self.folder)
        facts = {"name": about.name, "group": about.group, "job_type": about.job_type, "tags": ", ".join(about.tags)}
        self.writer.add_text("about", "\n".join(f"- {key}: {value}" for key, value in facts.items() if value), 0)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Add the numbers."""
        for name, value in values.items():
            self.writer.add_scalar(name, value, step)
        self.writer.flush()

    def page(self, step: int, name: str, path: Path) -> None:
        """Say where the page lies."""
        self.writer.add_text(name, f"`{path}`", step)

    def film(self, step: int, name: str, path: Path) -> None:
        """Add the film as a moving picture of half its size and rate."""
        import imageio_ffmpeg
        from tensorboard.compat.proto.summary_pb2 import Summary

        words = ["-v", "error", "-i", str(path), "-vf", "fps=10,scale=240:-1", "-f", "gif", "-"]
        gif = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), *words], capture_output=True, check=True).stdout
        image = Summary.Image(height=240, width=240, colorspace=3, encoded_image_string=gif)
        self.writer._get_file_writer().add_summary(Summary(value=[Summary.Value(tag=name, image=image)]), step)

    def histogram(self, step: int, name: str, counts: np.ndarray) -> None:
        """Add the counts, one bucket each."""
        ranks = np.arange(len(counts))
        sums = {"sum": float((counts * ranks).sum()), "sum_squares": float((counts * ranks**2).sum())}
        self.writer.add_histogram_raw(
            name,
            min=0,
            max=len(counts),
            num=int(counts.sum()),
            bucket_limits=(ranks + 1.0).tolist(),
            bucket_counts=counts.tolist(),
            global_step=step,
            **sums,
        )

    def table(self, name: str, markdown: str, rows: Sequence[Sequence[str]]) -> None:
        """Add the table as text."""
        self.writer.add_text(name, markdown, 0)

    def artifact(self, files: Sequence[Path]) -> None:
        """Say where the files lie."""
        self.writer.add_text("artifact", "\n".join(f"- `{path}`" for path in files), 0)

    def close(self) -> None:
        """Close the file."""
        self.writer.close()
