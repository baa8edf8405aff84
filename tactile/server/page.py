"""Page of the server: files of the folder ``web``, with headers that let it load nothing else."""

import os
from pathlib import Path

from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

FOLDER = Path(__file__).parent / "web"
"""Folder with the page; the JavaScript in it is compiled by ``python -m clients.build``."""
CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",  # no other page can lay itself over the button that arms
        "require-trusted-types-for 'script'",
        "trusted-types 'none'",
    )
)
"""Policy by which a browser runs no script and opens no connection but those of this server."""
HEADERS = {
    "content-security-policy": CONTENT_SECURITY_POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-cache",  # the page of another version of the server must not be used
}
"""Headers of each file."""
TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
"""Types of the files by suffix: those that a system registers may be others, as on Windows."""


class PageFiles(StaticFiles):
    """Files of the page."""

    def __init__(self) -> None:
        super().__init__(directory=FOLDER, html=True)

    def file_response(
        self,
        full_path: str | os.PathLike[str],
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        """Return a file with the headers of the page.

        Parameters
        ----------
        full_path : path-like
            Path of the file.
        stat_result : os.stat_result
            Its size and times.
        scope : dict
            Scope of the request.
        status_code : int
            Status of the response.

        Returns
        -------
        Response
            The file, or status 304 if the browser has it.
        """
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers.update(HEADERS)
        if "content-type" in response.headers:  # a response of status 304 has none
            response.headers["content-type"] = TYPES[Path(full_path).suffix]
        return response
