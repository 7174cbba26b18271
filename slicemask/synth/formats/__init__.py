"""The data sets that generated cities are written as: VIGOR and KITTI."""
