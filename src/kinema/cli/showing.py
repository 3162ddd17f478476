"""Do what `kinema demo` is asked: open the page of a model on this machine."""

from __future__ import annotations

import argparse
from typing import Annotated

from annotated_types import Interval

from kinema.demo import serve
from kinema.options import check_value
from kinema.pipeline import TextToMotion
from kinema.pipeline.models import DEFAULT, find_model

Port = Annotated[int, Interval(ge=1, le=65535)]


def demo(options: argparse.Namespace) -> None:
    """Serve the page until it is interrupted."""
    if options.port is not None:
        check_value(options.port, Port, "--port")
    name = options.run or DEFAULT
    model = TextToMotion.from_pretrained(name, options.device)
    title = find_model(name).name if model.card is None else model.card.name
    serve(model, title, host="127.0.0.1", port=options.port, share=options.share)
