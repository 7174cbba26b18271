"""The slicemask command from a clone, without an install: `python cli.py build ...`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "model"))  # where slicematch is

from slicemask.cli.main import main

if __name__ == "__main__":
    main(prog_name="cli.py")
