"""Encoders in fewer bits: ONNX files of half precision, and of 8-bit convolutions."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Variant = Literal["fp16", "int8"]

# What computes in half precision. Means and lengths, whose 1e-8 is no such number, do not.
_HALF = {"Conv", "Relu", "Clip", "MaxPool"}


def write_variant(source: Path, target: Path, variant: Variant, images: NDArray[np.uint8]) -> None:
    """Write an encoder's ONNX file again, in fewer bits.

    Parameters
    ----------
    source, target : Path
        The file in float32, and where the other goes.
    variant : {"fp16", "int8"}
        Convolutions in half precision; or with 8-bit weights, a scale for each channel, and 8-bit
        activations, whose ranges are those that they have on the images.
    images : uint8 [n, height, width, 3]
        What it is given; for "int8" alone.
    """
    with _quiet():
        if variant == "fp16":
            _write_half(source, target)
        else:
            _write_int8(source, target, images)


def _write_half(source: Path, target: Path) -> None:
    import onnx
    from onnxruntime.transformers.float16 import convert_float_to_float16

    model = onnx.load(source)
    kept = sorted({node.op_type for node in model.graph.node} - _HALF)
    onnx.save(convert_float_to_float16(model, keep_io_types=True, op_block_list=kept), target)


def _write_int8(source: Path, target: Path, images: NDArray[np.uint8]) -> None:
    from onnxruntime.quantization import (
        CalibrationDataReader,
        QuantFormat,
        QuantType,
        quant_pre_process,
        quantize_static,
    )

    class _Images(CalibrationDataReader):  # type: ignore[misc]  # its package has no types
        def __init__(self) -> None:
            self._left = iter(images)

        def get_next(self) -> dict[str, Any] | None:
            image = next(self._left, None)
            return None if image is None else {"images": image[None]}

    prepared = target.with_name(f"{target.stem}.prepared.onnx")
    try:
        quant_pre_process(source, prepared, skip_symbolic_shape=True)
        quantize_static(
            prepared,
            target,
            _Images(),
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=["Conv"],
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
    finally:
        prepared.unlink(missing_ok=True)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the converters from advising their own developers."""
    log = logging.getLogger()
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(level)
