"""Hold the generative processes: noise schedules, DDPM and flow, their solvers, guidance, noise and masked errors."""
