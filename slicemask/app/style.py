"""How buttons of a page look."""

from typing import Any

_LINE = "#4a8bbd"
OUTLINED: dict[str, Any] = {"button_type": "primary", "button_style": "outline"}
# Panel marks the chosen one of several by a shadow alone, which is hard to see.
CHOICE: dict[str, Any] = {
    **OUTLINED,
    "stylesheets": [
        ".bk-btn.bk-active { background: #1c6ea4 !important; color: #fff !important; }"
    ],
}
DOWNLOAD: dict[str, Any] = {
    "button_type": "primary",
    "stylesheets": [f".bk-btn {{ border: 1px solid {_LINE} !important; border-radius: 4px; }}"],
}
