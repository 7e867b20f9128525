"""The page itself: files that `page/` at the top of the source tree is built into."""

from __future__ import annotations

from functools import lru_cache, partial
from importlib.resources import files

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

TYPES = {
    "index.html": "text/html",
    "live.html": "text/html",
    "viewer.js": "text/javascript",
    "viewer.css": "text/css",
    "licences.txt": "text/plain",
}
"""What is served, by name; no other file is."""


@lru_cache
def read_file(name: str) -> bytes:
    """One of the built files."""
    return (files("fieldgrid.view") / "static" / name).read_bytes()


def routes(front: str = "index.html") -> list[Route]:
    """A page at the root, and the files that it loads beside it."""
    return [
        Route("/", partial(_file, name=front)),
        *(
            Route(f"/{name}", partial(_file, name=name))
            for name in TYPES
            if not name.endswith(".html")
        ),
    ]


def _file(request: Request, name: str) -> Response:
    return Response(
        read_file(name),
        media_type=f"{TYPES[name]}; charset=utf-8",
        headers={"Cache-Control": "no-cache"},
    )
