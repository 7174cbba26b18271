"""The group of all commands: what they are, and how their errors end."""

import errno
import gc
import importlib
from typing import Any

import click

from slicemask._version import __version__
from slicemask.cli.imports import without_collection
from slicemask.errors import SlicemaskError
from slicemask.interrupts import exit_on_signals

# Where each command lives, and its line in the list of commands, so that listing them imports
# none: `slicemask --help` answers in 0.1 s, and NumPy and h5py alone take as long.
_COMMANDS = {
    "build": ("bank", "Build the bank of a pose grid, or of a list of poses."),
    "info": ("bank", "Show what a bank holds."),
    "verify": ("bank", "Recompute a bank's masks with the other engine and compare."),
    "visualize": ("bank", "Draw the slices of a pose."),
    "synth": (
        "synth",
        "Generate a city with exact poses: VIGOR, KITTI, a map, or drives.",
    ),
    "table": ("table", "List photographs in a table: of VIGOR, KITTI, or a folder."),
    "train": ("train", "Train SliceMatch; the paper's settings are the defaults."),
    "evaluate": ("evaluate", "Measure the errors of a trained RUN."),
    "calibrate": ("train", "Fit the temperature that makes scores of a RUN probabilities."),
    "predict": ("predict", "Find where a ground image was taken, with a trained RUN."),
    "app": ("app", "Serve a page: slices, answers of a trained RUN, or a track."),
    "pack": ("pack", "Pack what predicting with a trained RUN takes into a folder."),
    "export": ("export", "Export a RUN as files of ONNX or torch.export."),
    "locate": ("locate", "Find where PHOTOS were taken on a map, with a trained RUN."),
    "track": ("track", "Follow a camera along a drive on a map, with a trained RUN."),
    "tiles": ("locate", "Cut the aerial tiles of a TABLE of photographs from a map."),
    "benchmark": ("evaluate", "Time encoding, aggregation and scoring."),
}


class _Group(click.Group):
    """Commands that are imported when they are asked for.

    Their expected errors are one sentence and exit code 1.
    """

    def main(self, args: Any = None, *more: Any, **extra: Any) -> Any:
        """Run the command; its context's object is whether the process is nothing but it.

        That is so where the arguments are the process's own; tests, for one, hand them over.
        """
        return super().main(args, *more, obj=args is None, **extra)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return super().get_command(ctx, cmd_name)
        with without_collection():
            module = importlib.import_module(f"slicemask.cli.{_COMMANDS[cmd_name][0]}")
        command: click.Command = getattr(module, cmd_name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        limit = formatter.width - 6 - max(map(len, _COMMANDS))
        rows = [
            (name, click.Command(name, help=text).get_short_help_str(limit))
            for name, (_, text) in _COMMANDS.items()
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def invoke(self, ctx: click.Context) -> Any:
        # What was imported is not garbage at the end, either.
        gc.freeze()
        try:
            # What is half-written is cleared away on the way out, for `kill` as for Ctrl-C.
            with exit_on_signals():
                return super().invoke(ctx)
        except SlicemaskError as error:
            raise click.ClickException(str(error)) from error
        except (MemoryError, RuntimeError) as error:
            from slicemask.errors import is_out_of_memory

            if not is_out_of_memory(error):
                raise
            raise click.ClickException(
                "this takes more memory than there is; ask for fewer poses, slices or cells, or "
                "for smaller batches or images"
            ) from error
        except OSError as error:
            if error.errno == errno.EPIPE:  # a reader that has seen enough, which click handles
                raise
            raise click.ClickException(str(error)) from error


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="slicemask")
def main() -> None:
    """Exact slice masks for cross-view localization."""
