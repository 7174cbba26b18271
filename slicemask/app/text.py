"""Texts of a page: code to copy, and a notice of what went wrong."""

from html import escape
from typing import Any

import panel as pn
from bokeh.models import Div

from slicemask.app.style import OUTLINED

_CODE = "white-space: pre-wrap; overflow-wrap: anywhere; margin: 0; font-size: 13px;"


class CodeBox:
    """Code, and a button that copies it.

    Parameters
    ----------
    name : str
        What language it is in.
    """

    def __init__(self, name: str) -> None:
        self.text = ""
        self._shown = pn.pane.HTML("", sizing_mode="stretch_width", css_classes=["code"])
        self._copy = pn.widgets.Button(name=f"Copy: {name}", width=190, **OUTLINED)
        self._held = Div(text="", visible=False)  # in no layout: it holds what is copied
        self._copy.js_on_click(
            args={"held": self._held}, code="navigator.clipboard.writeText(held.text)"
        )
        self.panel: Any = pn.Column(self._shown, self._copy, sizing_mode="stretch_width")

    def show(self, text: str) -> None:
        """Show other code."""
        self.text = self._held.text = text
        self._shown.object = f'<pre style="{_CODE}">{escape(text)}</pre>'


class Notice:
    """A sentence on what went wrong, read out by screen readers; nothing while all is well."""

    def __init__(self) -> None:
        self.panel: Any = pn.pane.HTML("", sizing_mode="stretch_width", css_classes=["notice"])

    def show(self, text: str) -> None:
        """Show a sentence; "" takes it away."""
        style = "border-left: 4px solid #d9480f; padding: 6px 10px; overflow-wrap: anywhere;"
        self.panel.object = (
            f'<div role="alert" class="fault" style="{style}">{escape(text)}</div>' if text else ""
        )
