"""Poses, frusta, and the exact share of each cell that a slice covers."""
