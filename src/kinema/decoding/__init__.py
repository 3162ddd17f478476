"""Hold the decoding loops over a `predict` callable."""
