"""Poses over time: a filter over place and heading that follows a camera along its drive."""
