"""Graphs as files of a format, and files as functions of arrays again."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from slicematch.errors import ConfigError

Format = Literal["onnx", "torch-export"]
SUFFIXES: dict[Format, str] = {"onnx": ".onnx", "torch-export": ".pt2"}

# What a file computes: arrays by name to its one result.
Function = Callable[[Mapping[str, NDArray[Any]]], NDArray[Any]]
# An input: its name, an example, and names of the axes whose length is free, by number. Examples
# are at least 2 long there, since lengths of 1 are taken for fixed.
Input = tuple[str, Tensor, Mapping[int, str]]


def check_installed(kind: Format) -> None:
    """Refuse a format whose packages are missing.

    Raises
    ------
    ConfigError
        With what to install.
    """
    if kind != "onnx":
        return
    try:
        import onnx  # noqa: F401
        import onnxruntime  # noqa: F401
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            f"the format onnx needs onnx, onnxscript and onnxruntime ({error}); install: "
            "pip install 'slicemask[export]', or choose the format torch-export"
        ) from error


def write(
    graph: nn.Module, inputs: Sequence[Input], output: tuple[str, str], path: Path, kind: Format
) -> None:
    """Write a graph as a file.

    Parameters
    ----------
    graph : Module
        Takes the inputs' examples in their order, those named alike but for a number as a list.
    inputs : sequence of (name, example, axes)
        See `Input`.
    output : (name, axis)
        Name of the result, and of its first axis.
    path : Path
        The file.
    kind : {"onnx", "torch-export"}
        Its format.
    """
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter's own house
        dims = dict.fromkeys(range(8), torch.export.Dim.DYNAMIC)
        shapes = [{axis: dims[axis] for axis in axes} for _, _, axes in inputs]
        program = torch.export.export(
            graph,
            tuple(_grouped([name for name, _, _ in inputs], [x for _, x, _ in inputs])),
            dynamic_shapes=tuple(_grouped([name for name, _, _ in inputs], shapes)),
            strict=False,
        )
        if kind == "torch-export":
            torch.export.save(program, path)
            return
        # The optimiser of onnxscript takes the 1e-8 that keeps lengths above 0 for a zero.
        found = torch.onnx.export(
            program,
            dynamo=True,
            optimize=False,
            verbose=False,
            external_data=False,
            input_names=[name for name, _, _ in inputs],
            output_names=[output[0]],
        )
        assert found is not None
        found.save(path)
        _write_out_sigmoids(path)


def read(path: Path, threads: int = 1) -> Function:
    """The function of a file that `write` wrote, computed by its format's own runtime."""
    if path.suffix == SUFFIXES["onnx"]:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3  # no warnings
        session = onnxruntime.InferenceSession(path, options, ["CPUExecutionProvider"])
        return lambda feeds: np.asarray(session.run(None, dict(feeds))[0])
    module = torch.export.load(path).module()

    def run(feeds: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        tensors = [torch.from_numpy(np.ascontiguousarray(array)) for array in feeds.values()]
        with torch.no_grad():
            return np.asarray(module(*_grouped(list(feeds), tensors)).numpy())

    return run


def _write_out_sigmoids(path: Path) -> None:
    """Write sigmoids in an ONNX file as 1 / (1 + exp(-x)).

    Of its own, onnxruntime takes an approximation with errors of 1e-4.
    """
    import onnx

    model = onnx.load(path)
    one = "one_of_sigmoids"
    make = onnx.helper.make_node
    nodes = []
    for node in list(model.graph.node):  # no loop holds one
        if node.op_type != "Sigmoid":
            nodes.append(node)
            continue
        (source,), (result,) = node.input, node.output
        negated, exponential, above = (f"{result}_{n}" for n in ("negated", "exp", "above"))
        nodes += [
            make("Neg", [source], [negated]),
            make("Exp", [negated], [exponential]),
            make("Add", [exponential, one], [above]),
            make("Div", [one, above], [result]),
        ]
    if len(nodes) == len(model.graph.node):
        return  # an initialiser that nothing uses would be warned of
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.array(1, np.float32), one))
    onnx.save(model, path)


def _grouped(names: Sequence[str], values: Sequence[Any]) -> list[Any]:
    """Values in order; those whose names end in numbers as one list each."""
    found: dict[str, Any] = {}
    for name, value in zip(names, values, strict=True):
        stem = name.rstrip("0123456789")
        if stem == name:
            found[name] = value
        else:
            found.setdefault(stem, []).append(value)
    return list(found.values())
