"""When the figures of a session may be changed."""

from collections.abc import Callable
from typing import Any

import panel as pn


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
