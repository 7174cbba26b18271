"""The RUN argument, and the options that commands on a run share."""

import importlib.metadata
import re
from collections.abc import Callable
from typing import Any, get_args

import click
from slicematch.precision import Precision

from slicemask.cli.options import cache_option

PRECISIONS = click.Choice(get_args(Precision))

run_argument = click.argument("run")
grid_option = click.option(
    "--grid", metavar="RxCxH", help="Candidates.  [default: the run's test grid]"
)
checkpoint_option = click.option(
    "--checkpoint", type=click.Choice(["best", "last"]), default="best", show_default=True
)
device_option = click.option(
    "--device", default="auto", show_default=True, help="auto, cpu, cuda[:N]."
)
precision_option = click.option(
    "--precision",
    type=PRECISIONS,
    default="32-true",
    show_default=True,
    help="Of the encoders; what follows them is float32. 16-mixed: GPUs only.",
)
root_option = click.option(
    "--root", metavar="PATH", help="The data tree's folder, or a table.  [default: the run's]"
)
workers_option = click.option(
    "--workers", type=int, help="Processes that load images.  [default: the run's]"
)
dask_option = click.option(
    "--dask",
    metavar="WHERE",
    help="Do it on Dask: local, a number of processes here, or tcp://scheduler:8786.",
)
_RUN_OPTIONS = (
    run_argument,
    grid_option,
    click.option("--bank", metavar="FILE", help="A bank of candidates instead."),
    checkpoint_option,
    device_option,
    precision_option,
    cache_option,
    click.option(
        "--alone",
        is_flag=True,
        help="Of an ensemble, ask the first network alone: sooner, and other answers.",
    ),
)


refine_option = click.option(
    "--refine",
    type=click.Choice(["none", "mean", "fine", "continuous"]),
    help="The best candidate, the likeliest pose (a mean of candidates), coarse to fine around the "
    "best ones, or that and then gradients.  [default: mean]",
)


def run_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add RUN and the options of commands that use one."""
    for option in reversed(_RUN_OPTIONS):
        command = option(command)
    return command


def check_model_installed() -> None:
    """Refuse the command, with what to install, where packages of the model are missing."""
    missing = [name for name in _model_packages() if not _is_installed(name)]
    if missing:
        raise click.ClickException(
            f"this command needs {', '.join(missing)}; install: pip install 'slicemask[model]'"
        )


def _model_packages() -> list[str]:
    """The packages that `slicemask[model]` asks for, as its own metadata name them."""
    try:
        requirements = importlib.metadata.requires("slicemask") or []
    except importlib.metadata.PackageNotFoundError:  # a clone that is not installed
        return []
    return [
        re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        for requirement in requirements
        if re.search(r"""extra\s*==\s*["']model["']""", requirement)
    ]


def _is_installed(package: str) -> bool:
    try:
        importlib.metadata.distribution(package)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True
