"""Settings as they are written: YAML, values turned into the types of their fields, and texts."""

import collections.abc
import inspect
import math
import re
import types
import typing
from pathlib import Path
from typing import Any, Literal, Union

from slicematch.errors import ConfigError


def read_settings(path: str | Path) -> dict[str, Any]:
    """Read a YAML file of settings as it stands, with nothing in it run.

    Raises
    ------
    ConfigError
        If it is unreadable as a mapping.
    """
    import yaml  # here, so that the settings can be listed without it

    try:
        settings = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file of settings") from None
    except (OSError, ValueError, yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(f"{path}: is unreadable as YAML ({reason})") from error
    if not isinstance(settings, dict):
        raise ConfigError(f"{path}: holds no settings; expected lines such as 'encoder: vgg16'")
    return settings


def convert(name: str, value: Any, kind: Any) -> Any:
    """Return a setting's value as the type of its field, such as ``tuple[int, int] | None``.

    Text is taken for a number where one is wanted: YAML reads 1e-5, which has no point, as text.

    Raises
    ------
    ConfigError
        If it is none; the message names the setting.

    Examples
    --------
    >>> convert("learning_rate", "1e-5", float), convert("ground_size", [64, 128], tuple[int, int])
    (1e-05, (64, 128))
    """
    for choice in typing.get_args(kind) if _is_union(kind) else (kind,):
        matched, converted = _as(value, choice)
        if matched:
            return converted
    raise ConfigError(f"{name} is {value!r}; it must be {_describe(kind)}")


def documentation(settings: type) -> dict[str, tuple[str, str]]:
    """What a class's docstring says of its parameters.

    Parameters
    ----------
    settings : type
        A class with a numpydoc docstring.

    Returns
    -------
    dict
        Parameter name to its type and its description, each on one line.

    Examples
    --------
    >>> class Settings:
    ...     '''Settings.
    ...
    ...     Parameters
    ...     ----------
    ...     size : (height, width)
    ...         Pixels of
    ...         the image.
    ...     '''
    >>> documentation(Settings)
    {'size': ('(height, width)', 'Pixels of the image.')}
    """
    text = inspect.cleandoc(settings.__doc__ or "")
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w+\n-+\n|\Z)", text, re.DOTALL | re.MULTILINE)
    found = {}
    if section is not None:
        for names, kind, lines in re.findall(
            r"^(\S[^:\n]*) : (.*)\n((?:[ ]+.*\n|\n)*)", section[1] + "\n", re.MULTILINE
        ):
            for name in names.split(", "):
                found[name] = kind, " ".join(lines.split())
    return found


def _as(value: Any, kind: Any) -> tuple[bool, Any]:
    if typing.get_origin(kind) is Literal:
        return value in typing.get_args(kind), value
    if typing.get_origin(kind) is tuple:
        kinds = typing.get_args(kind)
        if not isinstance(value, list | tuple):
            return False, None
        if kinds[-1] is Ellipsis:
            kinds = (kinds[0],) * len(value)
        if len(kinds) != len(value):
            return False, None
        parts = [_as(part, part_kind) for part, part_kind in zip(value, kinds, strict=True)]
        return all(matched for matched, _ in parts), tuple(part for _, part in parts)
    if typing.get_origin(kind) is collections.abc.Mapping:
        return isinstance(value, dict), value
    if kind is float:
        if isinstance(value, bool):
            return False, None
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            return False, None
        return math.isfinite(number), number
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool), value
    if kind is str:
        value = str(value) if isinstance(value, Path) else value
        # No path may hold a null character.
        return isinstance(value, str) and "\0" not in value, value
    return isinstance(value, kind), value


def _is_union(kind: Any) -> bool:
    return isinstance(kind, types.UnionType) or typing.get_origin(kind) is Union


def _describe(kind: Any) -> str:
    if _is_union(kind):
        return " or ".join(_describe(choice) for choice in typing.get_args(kind))
    if typing.get_origin(kind) is Literal:
        return "one of " + ", ".join(typing.get_args(kind))
    if typing.get_origin(kind) is tuple:
        kinds = [k for k in typing.get_args(kind) if k is not Ellipsis]
        many = "" if len(kinds) == 1 else f"{len(kinds)} "
        return f"a list of {many}{_PLURALS[kinds[0]]}"
    if typing.get_origin(kind) is collections.abc.Mapping:
        return "a mapping of settings"
    return _WORDS[kind]


_WORDS = {
    str: "text without null characters",
    int: "a whole number",
    float: "a finite number",
    bool: "true or false",
    type(None): "none",
}
_PLURALS = {str: "texts", int: "whole numbers", float: "finite numbers"}
