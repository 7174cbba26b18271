"""Layouts under the switches that are on, and what they look like in a season."""

import numpy as np

from slicemask.synth.layout.city import City, lay_out_city
from slicemask.synth.render.scene import View
from slicemask.synth.vary.country import lay_out_country
from slicemask.synth.vary.junctions import with_roundabouts
from slicemask.synth.vary.roads import repave
from slicemask.synth.vary.season import draw_season, dress
from slicemask.synth.vary.suburbs import lay_out_suburb
from slicemask.synth.vary.switches import Variation
from slicemask.synth.vary.trees import Flora, grow

LANDSCAPES = {"suburbs": lay_out_suburb, "country": lay_out_country}


def lay_out(seed: tuple[int, ...], half_extent_m: float, variation: Variation, place: int) -> City:
    """Lay out a place: a city or, where switches say so, a suburb or a stretch of country.

    Kinds take turns, so that a city of several places has as many of each. The seed is the data
    set's, the number of the city and, where it has several, the place's own.
    """
    kinds = ["city", *(name for name in LANDSCAPES if name in variation)]
    kind = kinds[(place + sum(seed[:2])) % len(kinds)]
    if kind != "city":
        return LANDSCAPES[kind](seed, half_extent_m, variation)
    city = lay_out_city(seed, half_extent_m)
    if "roads" in variation:
        city = repave(city, variation.random("roads"))
    if "trees" in variation:
        rng = variation.random("trees")
        city = grow(city, Flora.draw(rng), rng)
    if "junctions" in variation:
        city = with_roundabouts(city, variation.random("junctions"))
    return city


def in_season(city: City, variation: Variation, view: View) -> City:
    """A place as it looks when it is seen from the street or from above.

    Half of all places are seen in one season by both.
    """
    if "season" not in variation:
        return city
    season = draw_season(variation.random("season"))
    if view == "aerial" and variation.random("season", 1).random() < 0.5:
        season = draw_season(variation.random("season", 2))
    return dress(city, season, np.random.default_rng(variation.seed))
