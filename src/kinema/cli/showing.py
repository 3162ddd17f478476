"""Do what `kinema demo` is asked: open the page of a model on this machine."""

from __future__ import annotations

import argparse
from typing import Annotated

from annotated_types import Interval

from kinema.demo import serve
from kinema.options import check_value
from kinema.pipeline import TextToMotion
from kinema.runs.latest import find_run

Port = Annotated[int, Interval(ge=1, le=65535)]


def demo(options: argparse.Namespace) -> None:
    """Serve the page until it is interrupted."""
    if options.port is not None:
        check_value(options.port, Port, "--port")
    model = TextToMotion.from_run(options.run, options.device)
    serve(model, find_run(options.run).name.split("-")[0], host="127.0.0.1", port=options.port, share=options.share)
