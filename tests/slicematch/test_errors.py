"""Errors that say the same, whoever raises them."""

import click
import pytest
import torch
from click.testing import CliRunner

from slicemask.cli.main import _Group
from slicemask.cli.output import print_result
from slicemask.errors import is_out_of_memory


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (MemoryError(), True),
        (torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB."), True),
        (RuntimeError("CUDA out of memory. Tried to allocate 2.00 GiB."), True),
        (RuntimeError("unable to mmap 8 bytes from file <a>: Cannot allocate memory (12)"), True),
        (RuntimeError("CUDA error: an illegal memory access was encountered"), False),
        (RuntimeError("the allocation of slices cannot be"), False),
        (ValueError("can't allocate memory"), False),
    ],
)
def test_what_says_that_memory_is_short(error, expected):
    assert is_out_of_memory(error) is expected


def test_memory_that_torch_lacks_is_one_sentence_in_any_command():
    @click.group(cls=_Group)
    def group():
        pass

    @group.command()
    def greedy():
        torch.empty(10**15)

    @group.command()
    def wrong():
        torch.empty(2) @ torch.empty(3)

    result = CliRunner().invoke(group, ["greedy"])
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith("Error: this takes more memory than there is")
    assert isinstance(CliRunner().invoke(group, ["wrong"]).exception, RuntimeError)


def test_json_holds_no_number_that_is_none():
    with pytest.raises(click.ClickException, match="a figure is not finite"):
        print_result(True, {"loss": float("nan")}, "")
