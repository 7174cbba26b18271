"""Serving a page: on this computer alone, unless told otherwise."""

import errno
import socket
from collections.abc import Callable
from typing import Any

import panel as pn

from slicemask.app.uploads import MOST_BYTES
from slicemask.errors import AppError

DEFAULT_ADDRESS, DEFAULT_PORT = "127.0.0.1", 5006
_ANY_ADDRESS = ("", "0.0.0.0", "::")
# A message carries a chunk of an upload, coded in some more bytes.
_MOST_MESSAGE_BYTES = MOST_BYTES


def serve(
    make_page: Callable[[], Any],
    *,
    address: str = DEFAULT_ADDRESS,
    port: int = DEFAULT_PORT,
    origins: tuple[str, ...] = (),
    show: bool = True,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Serve a page until it is interrupted.

    Everything that the page loads comes from this server, which serves no folder of the user's.

    Parameters
    ----------
    make_page : callable
        Makes the page of a session.
    address : str
        Where to listen; by default only this computer can ask.
    port : int
        On which port; 0 for any that is free.
    origins : tuple of str
        Hosts, as browsers name them (``HOST:PORT``), whose pages may connect, beside this one.
    show : bool
        Whether to open the page in a browser.
    ready : callable, optional
        Called with the page's address once it is served.

    Raises
    ------
    AppError
        If the address or the port cannot be used.
    """
    pn.extension("filedropper", inline=False)
    try:
        port = port or _free_port(address)
        local = "127.0.0.1" if address in _ANY_ADDRESS else address
        hosts = [f"{name}:{port}" for name in (local, "localhost")]
        server = pn.io.server.get_server(
            {"/": make_page},
            port=port,
            address=address,
            websocket_origin=[*hosts, *origins],
            title="slicemask",
            websocket_max_message_size=_MOST_MESSAGE_BYTES,
            start=False,
        )
    except OSError as error:
        raise AppError(_why_not(error, address, port)) from error
    server.start()
    if ready is not None:
        ready(f"http://{hosts[0]}")
    if show:
        server.io_loop.add_callback(server.show, "/")
    try:
        server.io_loop.start()
    finally:
        server.stop()


def _free_port(address: str) -> int:
    """A port that nothing listens on. Browsers' origins hold it: it must be known before."""
    with socket.create_server((address, 0)) as probe:
        port: int = probe.getsockname()[1]
        return port


def _why_not(error: OSError, address: str, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"port {port} of {address} is in use; choose another with --port, or 0 for any"
    if error.errno == errno.EACCES:
        return f"port {port} may not be used; choose one above 1023 with --port"
    return f"{address}:{port} cannot be served: {error.strerror or error}; choose another address"
