"""Measure what MARDM §2 says of diffusion on motion features: marginals, deviations, errors and their amplification."""
