"""The pairs that come with the run that ships: generated places that it has not seen.

``python -m benchmarks.ship_examples RUN`` writes ``RUN/examples``: for each pair a panorama, turned
so that it does not face north, and its tile; and ``examples.json`` with the true poses.
"""

import json
from pathlib import Path

import click
import numpy as np
from PIL import Image
from slicematch.data.vigor import VigorConfig

from benchmarks.commands import slicemask

PLACES = (
    "--format", "vigor", "--cities", "1", "--places", "6", "--plain-places", "2",
    "--panoramas", "12", "--vary", "all", "--seed", "404", "--panorama-size", "1024x512",
    "--tile-size", "512",
)  # fmt: skip
# Which of the panoramas, what they show, and the headings that they are turned to.
PAIRS = ((3, "a street of a city", 231), (5, "a suburb", 64), (7, "a crossing in the country", 148))
QUALITY = 88


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--work", default="runs/ship/pairs", show_default=True, help="Where places go.")
def main(run: Path, work: str) -> None:
    """Write the pairs of RUN."""
    slicemask("synth", *PLACES, "--out", work)
    data = VigorConfig(
        root=work, split="cross-area", cities=("NewYork",), ground_size=(512, 1024),
        aerial_size=512, validation_fraction=0.0,
    ).open("train")  # fmt: skip
    folder = run / "examples"
    folder.mkdir(exist_ok=True)
    known = []
    for number, (index, name, heading_deg) in enumerate(PAIRS, 1):
        ground, tile = data.images(index, np.random.default_rng(0))
        u, v, towards_deg = data.pose(index, np.random.default_rng(0)).tolist()
        turn = round((heading_deg - towards_deg) / 360 * ground.width)
        turned = Image.fromarray(np.roll(np.asarray(ground), -turn, axis=1))
        files = {"ground": f"{number}_ground.jpg", "aerial": f"{number}_aerial.jpg"}
        for kind, image in (("ground", turned), ("aerial", tile)):
            image.save(folder / files[kind], quality=QUALITY)
        metres = float(data.tile_metres[index]) / tile.width
        known.append({
            "name": name, **files, "metres_per_pixel": round(metres, 6),
            "pose": [round(u, 5), round(v, 5), float(heading_deg)],
        })  # fmt: skip
    (folder / "examples.json").write_text(json.dumps(known, indent=2) + "\n")


if __name__ == "__main__":
    main()
