"""Options of a command, made from the settings of a training run.

Name, type, choices, default and help of each are those of the settings' own fields and docstring.
"""

import re
import typing
from collections.abc import Callable
from dataclasses import Field, fields
from typing import Any, Literal

import click
from slicematch.data import DATA_SETS, config_class
from slicematch.data.source import DataConfig
from slicematch.runs.config import TrainConfig
from slicematch.runs.settings import documentation

from slicemask.cli.options import NumberList, Numbers, ParamType


def setting_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option for each setting of a run and for each data set's own.

    None has a default of its own: what is not given comes from a file, the run, or the settings'
    defaults, which the help shows.
    """
    for option in reversed(_options()):
        command = option(command)
    return command


def data_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add options for another data set than a run's, and for each data set's own settings."""
    data = click.option(
        "--data",
        type=click.Choice(list(DATA_SETS)),
        help="The data set at --root, for runs of panoramas. What its own settings, which follow, "
        "do not say is as the run has it, or of another data set its default.  "
        "[default: the run's]",
    )
    for option in reversed([data, *_own_options(of_run=True)]):
        command = option(command)
    return command


def take_data_settings(options: dict[str, Any]) -> dict[str, Any]:
    """Take the data sets' own settings out of the options of a command with `data_options`."""
    names = {name for kind in _data_sets().values() for name in kind.own_settings()}
    return given_settings({name: options.pop(name) for name in names & options.keys()})


def given_settings(options: dict[str, Any]) -> dict[str, Any]:
    """The settings that were given as options, by the settings' names."""
    given = {name: value for name, value in options.items() if value is not None}
    return {name: None if value is NONE else value for name, value in given.items()}


class _None:
    """Stands for a setting that was given as None, since None is an option that was not given."""


NONE = _None()


class _OrNone(ParamType):
    """A number, or a word that stands for None."""

    def __init__(self, kind: ParamType, word: str) -> None:
        self._kind = kind
        self._word = word
        self.name = f"{kind.name}|{word}"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if str(value).lower() == self._word.lower():
            return NONE
        try:
            return self._kind.convert(value, param, ctx)
        except click.BadParameter:
            self.fail(f"{value!r} is neither a {self._kind.name} nor {self._word}", param, ctx)


class _Texts(ParamType):
    """Texts separated by commas."""

    name = "text,..."

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        return value.split(",") if isinstance(value, str) else value


def _options() -> list[Callable[..., Any]]:
    documented, classes = documentation(TrainConfig), _data_sets()
    options: list[Callable[..., Any] | None] = []
    for setting in fields(TrainConfig):
        if setting.name == "data_settings":
            options += _own_options()
            continue
        by_data = {name: getattr(kind, setting.name, None) for name, kind in classes.items()}
        options.append(_option(setting, *documented[setting.name], by_data))
    return [option for option in options if option is not None]


def _data_sets() -> dict[str, type[DataConfig]]:
    return {name: config_class(name) for name in DATA_SETS}


def _own_options(of_run: bool = False) -> list[Callable[..., Any]]:
    """Options of the settings that each data set has of its own."""
    options = []
    for data, kind in _data_sets().items():
        own = documentation(kind)
        options += [
            _option(field, own[field.name][0], f"{data}: {own[field.name][1]}", {}, of_run)
            for field in fields(kind)
            if field.name in kind.own_settings()
        ]
    return [option for option in options if option is not None]


def _option(
    setting: Field[Any],
    form: str,
    text: str,
    by_data: dict[str, Any],
    of_run: bool = False,
) -> Callable[..., Any] | None:
    """The option of a setting, or None if it has none; of a run's, help names no default."""
    name = setting.metadata.get("option", setting.name.replace("_", "-"))
    if name is None:
        return None
    kind: Any = setting.type
    if type(None) in typing.get_args(kind):
        kind = typing.get_args(kind)[0]
    text = text.replace("`", "")
    # What None stands for is the default of an option, and nothing that anyone types.
    none = re.search(r"[;,] [Nn]one for (.*?)(?=\.(\s|$)|:|$)", text)
    if none:
        text = text[: none.start()] + text[none.end() :]
    if not of_run:
        text += _default(setting, by_data, none[1] if none else None)
    if kind is bool:
        return click.option(f"--{name}/--no-{name}", setting.name, default=None, help=text)
    return click.option(f"--{name}", setting.name, type=_type(setting, kind, form), help=text)


def _type(setting: Field[Any], kind: Any, form: str) -> Any:
    if setting.name == "data":
        return click.Choice(list(DATA_SETS))
    if typing.get_origin(kind) is Literal:
        return click.Choice(typing.get_args(kind))
    if typing.get_origin(kind) is tuple:
        number, *rest = typing.get_args(kind)
        if rest == [Ellipsis]:
            return NumberList("6,12,24") if number is float else _Texts()
        return Numbers(form[1 : form.index(")")].replace(" ", ""), number)
    if "none" in setting.metadata:
        return _OrNone(click.types.convert_type(kind), setting.metadata["none"])
    return kind


def _default(setting: Field[Any], by_data: dict[str, Any], none: str | None) -> str:
    """What the help says of a setting's default."""
    if setting.name in TrainConfig.required:
        return "  [required, here or in --config]"
    if setting.default == ():
        return "  [default: none]"
    if setting.default is not None:
        return f"  [default: {_shown(setting.default)}]"
    if "none" in setting.metadata:
        return f"  [default: {setting.metadata['none']}]"
    values = {data: value for data, value in by_data.items() if value is not None}
    if not values:
        return f"  [default: {none}]" if none else ""
    return f"  [default: {', '.join(f'{_shown(v)} for {data}' for data, v in values.items())}]"


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return ",".join(map(_shown, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
