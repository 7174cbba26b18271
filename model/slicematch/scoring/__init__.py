"""Scores of candidate poses under their slice masks."""
