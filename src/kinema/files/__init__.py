"""Read files back, one reader for each kind: what a file says of itself is checked before it is believed."""
