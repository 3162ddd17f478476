"""Keep runs on disk: build modules from plain data, save and load their weights, and the folder around them."""
