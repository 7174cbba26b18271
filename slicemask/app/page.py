"""The frame of a page: two columns, one on a narrow screen; light or dark."""

from pathlib import Path
from typing import Any

import panel as pn
from panel.theme import Native
from panel.theme.base import DarkTheme, DefaultTheme

_TEMPLATE = Path(__file__).with_name("page.html")
HELP = (
    "Drag the camera; drag its yellow grip to turn it. Keys, once the tile has the focus: "
    "<kbd>←</kbd> <kbd>↑</kbd> <kbd>→</kbd> <kbd>↓</kbd> move, <kbd>Q</kbd> <kbd>E</kbd> turn, "
    "with <kbd>Shift</kbd> in finer steps and larger turns."
)


def page(left: Any, right: Any, *, subtitle: str, left_label: str, right_label: str) -> Any:
    """A page of two columns, for one session.

    Parameters
    ----------
    left, right : Panel objects
        What stands in the columns.
    subtitle : str
        What the page is for.
    left_label, right_label : str
        Names of the columns, for screen readers.

    Returns
    -------
    panel.Template
    """
    dark = asked_for_dark()
    template = pn.Template(
        _TEMPLATE.read_text(encoding="utf-8"),
        design=Native,
        theme=DarkTheme if dark else DefaultTheme,
    )
    template.add_variable("subtitle", subtitle)
    template.add_variable("left_label", left_label)
    template.add_variable("right_label", right_label)
    template.add_variable("scheme", "dark" if dark else "light")
    template.add_variable("other_scheme", "light" if dark else "dark")
    template.add_variable("paper", "#14181c" if dark else "#ffffff")
    template.add_variable("ink", "#e8ecef" if dark else "#17212b")
    template.add_panel("left", left)
    template.add_panel("right", right)
    return template


def asked_for_dark() -> bool:
    """Whether the session's address asks for a dark page."""
    return b"dark" in pn.state.session_args.get("theme", [])
