"""Runs that come with the package, packed (`slicematch.runs.packed`), each in a folder here."""

from pathlib import Path

_FOLDER = Path(__file__).parent


def shipped_runs() -> list[str]:
    """Names of the runs that come with the package."""
    return sorted(path.parent.name for path in _FOLDER.glob("*/config.yaml"))


def find_run(run: str | Path) -> Path:
    """The folder of a run.

    Parameters
    ----------
    run : path or str
        A run folder, or the name of a run that comes with the package. A run folder of that name
        goes before.
    """
    path = Path(run)
    if str(run) in shipped_runs() and not (path / "config.yaml").exists():
        return _FOLDER / str(run)
    return path
