"""A page to look at: a camera that is dragged over a tile, and its slices, bands and masks.

Built on Panel and Bokeh, which are imported when the page is served.
"""
