"""`python -m slicemask`: the command."""

from slicemask.cli.main import main

main(prog_name="slicemask")
