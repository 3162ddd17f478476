"""Measure what the MARDM paper (section 2) says of diffusion on motion features: marginals, deviations and errors."""
