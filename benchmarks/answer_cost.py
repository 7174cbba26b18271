"""``python -m benchmarks.answer_cost SIDE CACHE``: whole answers, in a process of their own.

Prints the processor's seconds of each answer after the first, on one thread, and the process's
peak memory, loading included. SIDE is a key of `SIDES`.
"""

import json
import resource
import sys
import time
from collections.abc import Callable

import numpy as np
import torch
from slicematch import Localizer
from slicematch.localization.members import load_candidates
from slicematch.network.slicematch import SliceMatch

from slicemask import Frustum, PoseGrid, build_bank

import timm  # isort: skip  after slicematch: see README

GRID = "21x21x64"
ANSWERS = 3
Answer = Callable[[], object]


def shipped(alone: bool) -> Callable[[str], Answer]:
    """The run that ships, or its first network, `--recipe fast`: from pictures to an answer."""

    def load(cache: str) -> Answer:
        localizer = Localizer.load("generated-city", grid=GRID, cache=cache, alone=alone)
        random = np.random.default_rng(0)
        ground, aerial = (
            random.integers(0, 256, shape, np.uint8) for shape in ((512, 1024, 3), (640, 640, 3))
        )
        return lambda: localizer.localize(ground, aerial)

    return load


def ours(encoder: str, cross_view_attention: bool = True) -> Callable[[str], Answer]:
    """SliceMatch as in the paper, but for its encoder: random weights, pictures as tensors."""

    def load(cache: str) -> Answer:
        frustum = Frustum()
        bank = build_bank(PoseGrid.parse(GRID), frustum, 32, engine="rays", cache=cache)
        candidates, _ = load_candidates(bank.path, frustum, 32)
        model = SliceMatch(encoder, "none", cross_view_attention=cross_view_attention)
        model.for_inference(torch.device("cpu"))
        pair = torch.randn(1, 3, 320, 640), torch.randn(1, 3, 512, 512)
        return lambda: model(*pair, candidates)

    return load


def features(encoder: str) -> Callable[[str], Answer]:
    """An encoder's features of both pictures, and nothing after them."""

    def load(_: str) -> Answer:
        nets = [
            timm.create_model(encoder, features_only=True, pretrained=False).eval()
            for _ in range(2)
        ]
        pair = torch.randn(1, 3, 320, 640), torch.randn(1, 3, 512, 512)
        return lambda: [net(picture) for net, picture in zip(nets, pair, strict=True)]

    return load


SIDES: dict[str, tuple[str, Callable[[str], Answer]]] = {
    "fast": ("--recipe fast, from pictures to the refined answer", shipped(alone=True)),
    "generated_city": ("generated-city: and one more network, likewise", shipped(alone=False)),
    "peers": (
        "efficientnet_b0's features of 320x640 and 512x512: HC-Net's and CCVPE's backbone and "
        "sizes, nothing after it",
        features("efficientnet_b0"),
    ),
    "b0": ("SliceMatch, efficientnet_b0", ours("efficientnet_b0")),
    "b0_plain": ("the same without cross-view attention", ours("efficientnet_b0", False)),
    "resnet50": ("SliceMatch, ResNet50", ours("resnet50")),
    "vgg16": ("--recipe paper: SliceMatch, VGG16", ours("vgg16")),
}


def main(side: str, cache: str) -> None:
    torch.set_num_threads(1)
    answer, seconds = SIDES[side][1](cache), []
    with torch.no_grad():
        for _ in range(1 + ANSWERS):
            start = time.process_time()
            answer()
            seconds.append(time.process_time() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(json.dumps({"seconds": seconds[1:], "peak_bytes": peak}))


if __name__ == "__main__":
    main(*sys.argv[1:])
