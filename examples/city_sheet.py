"""Draw a contact sheet of generated cities: pairs of both formats, cameras marked.

For instance::

    slicemask synth --format vigor --cities 2 --panoramas 12 --seed 7 --out data/city
    slicemask synth --format kitti --frames 8 --seed 2 --out data/drive
    python examples/city_sheet.py data/city data/drive docs/images/city.jpg
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

ROW, GAP = 300, 6
RED = (235, 40, 40)


def vigor_pairs(root: Path, per_city: int) -> list[list[Image.Image]]:
    """Panoramas and their tiles, the camera's place ringed."""
    rows = []
    for labels in sorted(root.glob("splits__corrected/*/pano_label_balanced__corrected.txt")):
        city = root / labels.parent.name
        lines = labels.read_text().splitlines()
        for line in lines[:: max(1, len(lines) // per_city)][:per_city]:
            panorama, tile, d0, d1 = line.split(" ")[:4]
            above = Image.open(city / "satellite" / tile).convert("RGB").resize((ROW, ROW))
            u, v = 0.5 - float(d1) / 640, 0.5 + float(d0) / 640
            _ring(above, u, v)
            street = Image.open(city / "panorama" / panorama).resize((2 * ROW, ROW))
            rows.append([street, above])
    return rows


def kitti_pairs(root: Path) -> list[list[Image.Image]]:
    """A camera image of either city and its tile, the camera's heading drawn."""
    rows = []
    for part in ("train", "test2"):
        frame = (root / f"{part}_files.txt").read_text().split()[0]
        drive, name = frame.rsplit("/", 1)
        raw = root / "raw_data" / drive
        above = Image.open(root / "satmap" / frame).convert("RGB").resize((ROW, ROW))
        oxts = raw / "oxts" / "data" / Path(name).with_suffix(".txt")
        yaw = float(oxts.read_text().split()[5])
        _ring(above, 0.5, 0.5)
        ahead = np.array([np.cos(yaw), -np.sin(yaw)]) * 45 + ROW / 2
        ImageDraw.Draw(above).line([(ROW / 2, ROW / 2), tuple(ahead)], RED, 3)
        street = Image.open(raw / "image_02" / "data" / name)
        cut = (street.width - 2 * street.height) // 2
        street = street.crop((cut, 0, street.width - cut, street.height))
        rows.append([street.resize((2 * ROW, ROW)), above])
    return rows


def _ring(tile: Image.Image, u: float, v: float) -> None:
    x, y = u * tile.width, v * tile.height
    ImageDraw.Draw(tile).ellipse((x - 8, y - 8, x + 8, y + 8), outline=RED, width=3)


def main(vigor: str, kitti: str, out: str) -> None:
    """Write the sheet."""
    pairs = vigor_pairs(Path(vigor), 3) + kitti_pairs(Path(kitti))
    wide = 3 * ROW + GAP
    sheet = Image.new("RGB", (2 * wide + 3 * GAP, -(-len(pairs) // 2) * (ROW + GAP) + GAP), "white")
    for number, (street, above) in enumerate(pairs):
        left = GAP + (number % 2) * (wide + GAP)
        top = GAP + number // 2 * (ROW + GAP)
        sheet.paste(street, (left, top))
        sheet.paste(above, (left + 2 * ROW + GAP, top))
    sheet.resize((1240, round(1240 * sheet.height / sheet.width))).save(out, quality=80)


if __name__ == "__main__":
    main(*sys.argv[1:])
