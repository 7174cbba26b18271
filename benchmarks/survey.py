"""Where four of the real pairs were really taken, surveyed by hand.

``python -m benchmarks.survey PAIRS OUT`` prints how far the labels are off, and writes them put
right into ``OUT/pairs.csv``, which ``python -m benchmarks.real_pairs RUN OUT`` reads. Nothing of it
comes from a network: ends of road markings, a bench and such were found by eye, in the tile (metres
from its centre) and in the panorama (degrees from its centre column), and place and heading are
those from which they are seen in these directions (resection, robust least squares). Height and
tilt of the camera hardly matter to it. The other pairs show too few such marks.
"""

import csv
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from slicematch.angles import angle_difference_deg

from benchmarks.real_pairs import read_pairs
from slicemask.images import read_image

# East and north of the tile's centre in metres, and direction in the panorama in degrees.
MARKS = {
    "suburb0": [
        (8.0, -3.8, 104.7),  # stop line in the east, its end in the junction
        (9.9, -2.8, 94.6),  # where it is painted anew
        (-2.2, -8.7, -150.4),  # stop line in the west, where it is painted anew
        (0.2, -7.8, -163.6),  # its end in the junction
        (7.9, -12.3, 147.8),  # centre line in the south, its near end
        (-7.2, 4.3, -57.0),  # where a path meets the kerb
    ],
    "suburb1": [
        (20.0, 9.3, 57.0),  # garage, the west end of its front
        (21.5, 6.9, 65.3),  # red roof, its west corner
        (16.8, -0.6, 84.0),  # edge of a bed beside the drive
        (13.5, -5.1, 106.0),  # where that drive's south side meets the kerb
        (-4.2, 11.5, -25.8),  # tip of the gap between the tracks of a drive in the north
        (-3.2, 8.6, -26.7),  # where that drive's near side meets the kerb
        (-7.0, 11.4, -35.5),  # and its far side
    ],
    "suburb2": [
        (-1.3, 5.0, -38.0),  # centre line in the north, its near end
        (1.3, 11.8, -10.3),  # give-way line, its last dash
        (-7.6, 5.0, -65.2),  # pale lid in the verge
        (7.3, 9.3, 22.5),  # ring around a young tree
        (6.5, -11.5, 161.7),  # dash in the south, its near end
    ],
    "corner0": [
        (-0.2, 9.2, -131.2),  # bench, its near post
        (12.4, 16.5, -53.0),  # block of concrete
        (-4.2, 4.3, 166.5),  # centre line in the north-west, its near end
        (-6.0, 1.6, 152.2),  # give-way line, its last dash
        (-4.2, -1.8, 130.0),  # stop line, its end
        (8.3, 13.0, -65.0),  # lamp post
    ],
}
# Directions that are off by more than this count for less.
_OUTLIER_DEG = 2.0


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("pairs", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
def main(pairs: Path, out: Path) -> None:
    """Write the labels of PAIRS into the folder OUT, four of them put right."""
    rows = read_pairs(pairs)
    for row in rows:
        row["ground"], row["aerial"] = (
            str((pairs / row[key]).resolve()) for key in ("ground", "aerial")
        )
        if row["id"] not in MARKS:
            continue
        pose, off_deg = resect(np.array(MARKS[row["id"]]))
        east, north, heading_deg = pose
        side_m = read_image(Path(row["aerial"])).width * float(row["metres_per_pixel"])
        turn_deg = angle_difference_deg(pose[2:], float(row["heading_deg"]))[0]
        click.echo(
            f"{row['id']}: {east:.1f} m east and {north:.1f} m north of the label, turned by "
            f"{turn_deg:.0f} degrees; directions fit to {np.sqrt(np.mean(off_deg**2)):.1f} degrees"
        )
        row["u"], row["v"] = f"{0.5 + east / side_m:.5f}", f"{0.5 - north / side_m:.5f}"
        row["heading_deg"] = f"{heading_deg % 360.0:.1f}"
    out.mkdir(parents=True, exist_ok=True)
    with (out / "pairs.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def resect(marks: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The place and heading from which marks are seen in their directions.

    Parameters
    ----------
    marks : float64 [m, 3]
        East and north in metres, and degrees clockwise from the heading.

    Returns
    -------
    pose : float64 [3]
        East, north and heading.
    off_deg : float64 [m]
        How far the directions are off then.
    """

    def off_deg(pose: NDArray[np.float64]) -> NDArray[np.float64]:
        azimuths_deg = np.degrees(np.arctan2(*(marks[:, :2] - pose[:2]).T))
        return angle_difference_deg(azimuths_deg, marks[:, 2] + pose[2])

    # From several headings, since a turn by half a circle is a minimum of its own.
    fits = [
        least_squares(off_deg, [0.0, 0.0, heading_deg], loss="soft_l1", f_scale=_OUTLIER_DEG)
        for heading_deg in (0.0, 90.0, 180.0, 270.0)
    ]
    best = np.asarray(min(fits, key=lambda fit: float(fit.cost)).x)
    return best, off_deg(best)


if __name__ == "__main__":
    main()
