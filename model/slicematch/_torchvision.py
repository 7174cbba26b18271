"""Lets timm and Lightning be imported beside a torchvision without its compiled operators.

Both import torchvision. Beside a torch of another build (a CPU torch next to the torchvision that
was compiled for CUDA, or the reverse), torchvision's compiled library cannot be loaded, and its
import then ends in "operator torchvision::nms does not exist", because it describes operators that
nobody has declared. Nothing here uses those operators. Declaring them, without an implementation,
is enough for the import to go through; where the compiled library is there, nothing is declared.

Import this module before timm or lightning. If one of these was tried first and failed, it can be
imported once this module has been.
"""

import torch


def _declare_missing_operators() -> torch.library.Library | None:
    try:
        import torchvision  # noqa: F401
    except ImportError:
        return None  # timm says it better
    except RuntimeError as error:
        if "operator torchvision::" not in str(error):
            raise
    else:
        return None
    library = torch.library.Library("torchvision", "DEF")
    for name in ("nms", "qnms"):
        library.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    return library


# The declarations live as long as this object does.
_DECLARED = _declare_missing_operators()
