"""Captured motion as its owners publish it: other skeletons, units, axes and rates, brought to the 22 joints."""
