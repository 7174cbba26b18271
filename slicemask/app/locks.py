"""When the figures of a session may be changed, and when they should be."""

from collections.abc import Callable
from typing import Any

import panel as pn

_REST_MS = 400


def when_locked(work: Callable[[], Any]) -> None:
    """Do work that changes Bokeh's models once the session's document is locked for it.

    Panel tells of its widgets' values without that lock. Without a session it is done at once.

    Parameters
    ----------
    work : callable
        Called without arguments.
    """
    document = pn.state.curdoc
    if document is None or not document.session_context:
        work()
    else:
        document.add_next_tick_callback(work)


class AtRest:
    """Work of a session that waits until it has not been asked for again for a while.

    Without a session it is done at once.

    Parameters
    ----------
    work : callable
        Called without arguments.
    """

    def __init__(self, work: Callable[[], Any]) -> None:
        self._work = work
        self._waiting: Any = None

    def __call__(self) -> None:
        """Ask for the work."""
        document = pn.state.curdoc
        if document is None or not document.session_context:
            self._work()
            return
        if self._waiting is not None:
            document.remove_timeout_callback(self._waiting)
        self._waiting = document.add_timeout_callback(self._rested, _REST_MS)

    def _rested(self) -> None:
        self._waiting = None
        self._work()
