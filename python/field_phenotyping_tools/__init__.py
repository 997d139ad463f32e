"""Scores and pictures of field_phenotyping runs: numpy, scipy and matplotlib, no ROS."""
