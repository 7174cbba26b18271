"""Puts off the import of torch's compiler, for commands that answer at once.

timm, torchvision and torch itself import `torch._dynamo` only to mark functions that it should
leave alone and to ask what it supports: 1.4 s of the 4 s that a command took to answer. Until
something else is asked of it, a stand-in answers both; then the real one takes its place.

For processes of our own alone, and there before timm is imported: functions that were marked by the
stand-in bear no mark, should the process compile a model later.
"""

import importlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

_NAMES = ("torch._dynamo", "torch._dynamo.utils")


def defer_compiler() -> None:
    """Put a stand-in where `torch._dynamo` would be, unless that is imported already."""
    import torch  # noqa: F401

    if _NAMES[0] not in sys.modules:
        sys.modules.update({name: _StandIn(name) for name in _NAMES})


class _StandIn(ModuleType):
    def is_compile_supported(self, device_type: str) -> bool:
        return False

    def disable(self, fn: Callable[..., Any] | None = None, *_: Any, **__: Any) -> Any:
        return fn if fn is not None else lambda function: function

    def __getattr__(self, name: str) -> Any:
        # `inspect` asks all modules for their files. Only imports of other parts ask for the path.
        if name.startswith("__") and (name, self.__name__) != ("__path__", _NAMES[0]):
            raise AttributeError(name)
        for stand_in in _NAMES:
            if isinstance(sys.modules.get(stand_in), _StandIn):
                del sys.modules[stand_in]
        return getattr(importlib.import_module(self.__name__), name)
