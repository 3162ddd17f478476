"""Serve the page: on this machine alone unless told otherwise, without telemetry, with files in one folder."""

from __future__ import annotations

import os
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from tempfile import TemporaryDirectory
from typing import Any

from kinema.demo.studio import Studio
from kinema.pipeline import TextToMotion

LOCAL = ("127.0.0.1", "localhost")
MOST_BYTES = 1 << 20
"""Bytes of a request; one that is fair needs a thousandth."""


def serve(
    model: TextToMotion,
    title: str = "text to motion",
    *,
    host: str | None = None,
    port: int | None = None,
    share: bool = False,
) -> None:
    """Serve the page of a model until the process is interrupted.

    `host` is the address to listen on (None: GRADIO_SERVER_NAME, which a Space sets, else 127.0.0.1), `port` a free one
    from 7860 on if left out. `share` asks gradio for a public address: whoever knows it uses this machine. Raises
    ImportError where gradio is missing, OSError for a port that is in use.
    """
    with _environment():
        try:
            import gradio  # noqa: F401
        except ImportError as error:
            raise ImportError("the demo needs gradio: pip install 'kinema[demo]'") from error
        from kinema.demo.page import build

        blocks = build(Studio(model), title)
        try:
            alone = not share and (host or os.environ.get("GRADIO_SERVER_NAME", LOCAL[0])) in LOCAL
            _, local, public = blocks.launch(server_name=host, server_port=port, share=share, **_launch(alone))
            print(f"open {public or local} (Ctrl+C ends it)", flush=True)
            threading.Event().wait()
        finally:
            blocks.close(verbose=False)


def _launch(alone: bool) -> dict[str, Any]:
    """Return what gradio is told of the page's looks, of what it leaves out, and (`alone`) whom it answers."""
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware

    from kinema.demo.views import asset, theme

    looks = {"theme": theme(), "css": asset("demo.css"), "head": f"<script>{asset('head.js')}</script>"}
    off = dict.fromkeys(("run_history", "ssr_mode", "pwa", "mcp_server", "enable_monitoring"), False)
    # A page elsewhere whose name is made to lead here is not answered.
    known = [Middleware(TrustedHostMiddleware, allowed_hosts=list(LOCAL))] if alone else []
    bounds = {"max_file_size": 1, "app_kwargs": {"middleware": [*known, Middleware(Bounded)]}}
    return {**looks, **off, **bounds, "footer_links": [], "quiet": True, "prevent_thread_lock": True}


class Bounded:
    """Refuse requests that send more than `MOST_BYTES`, or don't say how much: an ASGI middleware."""

    def __init__(self, app: Callable[..., Awaitable[None]]) -> None:
        self.app = app

    async def __call__(
        self, scope: dict[str, Any], receive: Callable[..., Any], send: Callable[..., Awaitable[None]]
    ) -> None:
        """Answer 413, or hand the request on."""
        if scope["type"] == "http" and scope["method"] in ("POST", "PUT", "PATCH"):
            size = dict(scope["headers"]).get(b"content-length", b"")
            if not size.isdigit() or int(size) > MOST_BYTES:
                await send({"type": "http.response.start", "status": 413, "headers": []})
                await send({"type": "http.response.body", "body": b"too large"})
                return
        await self.app(scope, receive, send)


@contextmanager
def _environment() -> Iterator[None]:
    """Keep gradio's files in one folder that goes with the server, and what it would tell its makers to itself."""
    before = dict(os.environ)
    with TemporaryDirectory(prefix="kinema-demo-") as folder:
        os.environ |= {"GRADIO_TEMP_DIR": folder, "GRADIO_ANALYTICS_ENABLED": "False", "HF_HUB_DISABLE_TELEMETRY": "1"}
        try:
            yield
        finally:
            os.environ.clear()
            os.environ |= before
