"""Errors, calibration and timings of a trained run, and pictures of them."""
