"""Fit rotations of a T-posed skeleton to joint positions, so that other tools can play a motion."""
