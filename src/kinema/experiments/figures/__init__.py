"""Draw the papers' figures that are no tables."""
