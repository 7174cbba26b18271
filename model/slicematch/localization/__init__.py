"""Answers: the pose of a ground image in an aerial tile, and how sure it is."""
