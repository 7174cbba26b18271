"""Banks: the distinct slice masks of many poses, in one HDF5 file."""
